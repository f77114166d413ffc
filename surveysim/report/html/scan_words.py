"""The scan pattern of a scene in words."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from surveysim.runtime.numbers import plural, short

Values = Mapping[str, Any]


def scan_words(scan: Values) -> str:
    """Describe a section [scan] in sentences, the first without its beginning; `scan` is that of `resolved`."""
    return _WORDS[scan.get("pattern", "raster")](scan)


def _raster(scan: Values) -> str:
    return (
        f"{plural(scan['scans'], 'scan')} of {short(scan['duration_s'])} s at {_arcmin(scan['speed_rad_s'])}/s,"
        f" turnarounds of {short(scan['turnaround_s'])} s. Scans are {_arcmin(scan['step_rad'])} apart."
    )


def _daisy(scan: Values) -> str:
    turn = f" that turns in {short(scan['rotation_period_s'])} s" if scan["rotation_period_s"] else ""
    return (
        f"a daisy of radius {_arcmin(scan['radius_rad'])}, with a period of {short(scan['radial_period_s'])} s along a"
        f" diameter{turn}, {_chunks(scan)}"
    )


def _chunks(scan: Values) -> str:
    return f"for {short(scan['total_s'])} s in chunks of {short(scan['duration_s'])} s."


def _arcmin(angle: float) -> str:
    return f"{short(float(f'{math.degrees(angle) * 60:.9g}'))} arcmin"


_WORDS: dict[str, Callable[[Values], str]] = {"raster": _raster, "daisy": _daisy}
