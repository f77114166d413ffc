"""Memory of this process and of the machine."""

import math
import os
import sys


def peak_bytes() -> float:
    """Peak memory of this process [byte]; NaN where the system does not report it."""
    try:
        import resource
    except ImportError:  # not a Unix system
        return math.nan
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)


def machine_bytes() -> float:
    """Largest memory of a process [byte], by the machine or its resource limits; inf if unknown."""
    try:
        most = float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):  # not a Unix system
        return math.inf
    import resource

    limits = (resource.getrlimit(kind)[0] for kind in (resource.RLIMIT_AS, resource.RLIMIT_DATA))
    return min([most, *(float(limit) for limit in limits if limit != resource.RLIM_INFINITY)])
