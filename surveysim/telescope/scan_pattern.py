"""The scan patterns."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.scene.observing import Scan
from surveysim.scene.section import Section
from surveysim.telescope.horizon_frame import HorizonFrame
from surveysim.telescope.raster import observation_raster, raster_extent, scene_raster
from surveysim.telescope.scans import ScanPath, Scans


@dataclass(frozen=True)
class ScanPattern:
    """A scan pattern.

    Parameters
    ----------
    name
    section
        Class of the section [scan] that asks for it.
    scans
        Function that makes the pattern's record, with the number and timing of scans, from the section.
    path
        Function of that record, the number of an observation, its dither (2,) [rad], and the horizon during it, None at
        fixed pointing: path of the boresight.
    extent_rad
        Function of that record: largest offset of the boresight from the centre of the pattern, along either axis.
    """

    name: str
    section: type[Section]
    scans: Callable[[Any], Scans]
    path: Callable[[Any, int, np.ndarray, HorizonFrame | None], ScanPath]
    extent_rad: Callable[[Any], float]


SCAN_PATTERNS = (ScanPattern("raster", Scan, scene_raster, observation_raster, raster_extent),)


def scan_pattern(section: Section) -> ScanPattern:
    """Find the pattern of a section [scan]."""
    return next(item for item in SCAN_PATTERNS if isinstance(section, item.section))
