"""Daisy scans: a rose curve through the centre of the field.

The boresight oscillates along a diameter that turns: `Daisy` of the Green Bank Telescope, used with MUSTANG and
MUSTANG-2 ("GBT Observer's Guide", section on scan types):

    x = R sin(2 pi t / T) cos(2 pi t / T'),   y = R sin(2 pi t / T) sin(2 pi t / T'),

with the radius R, the radial period T and the period T' of the rotation. The guide has T' = pi T.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.scan_patterns import DaisyScan
from surveysim.telescope.horizon_frame import HorizonFrame
from surveysim.telescope.patterns.chunks import chunked_path
from surveysim.telescope.scans import ScanPath, Scans, timing


@dataclass(frozen=True, kw_only=True)
class Daisy(Scans):
    """Daisy of one observation."""

    radius_rad: float
    radial_period_s: float
    turn_s: float

    def offsets(self, time_s: np.ndarray) -> np.ndarray:
        """Compute the boresight's offsets (2, ...) from the centre [rad], first along x, at times since the start."""
        radial = self.radius_rad * np.sin(2 * np.pi * time_s / self.radial_period_s)
        turn = 2 * np.pi * time_s / self.turn_s
        return np.stack([radial * np.cos(turn), radial * np.sin(turn)])


def scene_daisy(section: DaisyScan) -> Daisy:
    """Make the daisy of a section [scan]."""
    return Daisy(
        **timing(section),
        radius_rad=section.radius_rad,
        radial_period_s=section.radial_period_s,
        turn_s=section.turn_s,
    )


def daisy_extent(daisy: Daisy) -> float:
    """Return the largest offset from the centre [rad]."""
    return daisy.radius_rad


def daisy_path(daisy: Daisy, observation: int, dither: np.ndarray, frame: HorizonFrame | None) -> ScanPath:
    """Compute the boresight path of one observation; that of every observation begins alike."""
    return chunked_path(daisy, daisy.offsets, dither)
