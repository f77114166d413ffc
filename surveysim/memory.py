"""What memory this process has held."""

import math
import sys


def peak_bytes() -> float:
    """The most memory that this process has held since it began; NaN where the system does not say."""
    try:
        import resource
    except ImportError:  # not a Unix system
        return math.nan
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return float(peak if sys.platform == "darwin" else peak * 1024)
