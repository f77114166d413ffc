"""The scan patterns."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.scene.scan_figures import DaisyScan, LissajousScan, PongScan
from surveysim.scene.scan_patterns import RasterScan
from surveysim.scene.scan_section import ScanSection
from surveysim.scene.scan_sweeps import AzimuthScan
from surveysim.scene.scan_track import TrackScan
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.horizon_frame import HorizonFrame
from surveysim.telescope.patterns.azimuth import azimuth_extent, azimuth_path, scene_azimuth
from surveysim.telescope.patterns.daisy import scene_daisy
from surveysim.telescope.patterns.figures import figure_extent, figure_path
from surveysim.telescope.patterns.lissajous import scene_lissajous
from surveysim.telescope.patterns.pong import scene_pong
from surveysim.telescope.patterns.raster import observation_raster, raster_extent, scene_raster
from surveysim.telescope.patterns.track import scene_track, track_extent, track_path
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
        Function that makes the pattern's record, with the number and timing of scans, from the section, the centre of
        the field and the site, None at fixed pointing.
    path
        Function of that record, the number of an observation, its dither (2,) [rad], and the horizon during it, None at
        fixed pointing: path of the boresight.
    extent_rad
        Function of that record and the lowest elevation of the field [rad]: largest offset of the boresight from the
        centre of the pattern, along either axis.
    """

    name: str
    section: type[ScanSection]
    scans: Callable[[Any, FieldCentre, Site | None], Scans]
    path: Callable[[Any, int, np.ndarray, HorizonFrame | None], ScanPath]
    extent_rad: Callable[[Any, float], float]


SCAN_PATTERNS = (
    ScanPattern("raster", RasterScan, scene_raster, observation_raster, raster_extent),
    ScanPattern("azimuth", AzimuthScan, scene_azimuth, azimuth_path, azimuth_extent),
    ScanPattern("daisy", DaisyScan, scene_daisy, figure_path, figure_extent),
    ScanPattern("lissajous", LissajousScan, scene_lissajous, figure_path, figure_extent),
    ScanPattern("pong", PongScan, scene_pong, figure_path, figure_extent),
    ScanPattern("track", TrackScan, scene_track, track_path, track_extent),
)


def scan_pattern(section: ScanSection) -> ScanPattern:
    """Find the pattern of a section [scan]."""
    return next(item for item in SCAN_PATTERNS if isinstance(section, item.section))
