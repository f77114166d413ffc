"""Memory of this process and of the machine."""

import ctypes
import math
import os
import sys
from functools import cache

_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4  # constants of malloc.h


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


@cache
def keep_freed_memory() -> None:
    """Let malloc keep freed memory, within limits.

    By default glibc returns freed memory to the system, often at once in workers of dask, and maps large arrays anew.
    An observation of one or two megabytes then has up to 14000 page faults, and takes between a tenth longer and twice
    as long; one of ten thousand detectors a quarter longer. Other C libraries are not changed.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        mallopt(_M_MMAP_MAX, 0)
        mallopt(_M_TRIM_THRESHOLD, 1 << 30)
