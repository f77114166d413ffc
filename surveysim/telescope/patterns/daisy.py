"""Daisy scans: a rose curve through the centre of the field.

The boresight oscillates along a diameter that turns: `Daisy` of the Green Bank Telescope, used with MUSTANG and
MUSTANG-2 ("GBT Observer's Guide", section on scan types; Dicker et al. 2020, ApJ 902, 144):

    x = R sin(2 pi t / T) cos(2 pi t / T'),   y = R sin(2 pi t / T) sin(2 pi t / T'),

with the radius R, the radial period T and the period T' of the rotation. The guide has the phase 2 t / T in place of
2 pi t / T', so T' = pi T.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.scan_figures import DaisyScan
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.patterns.figures import Figure, figure_keys


@dataclass(frozen=True, kw_only=True)
class Daisy(Figure):
    """Daisy of one observation, with its radius and the periods along a diameter and of the rotation."""

    radius_rad: float
    radial_period_s: float
    turn_s: float

    def curve(self, time_s: np.ndarray) -> np.ndarray:
        """Compute the offsets (2, n)."""
        radial = self.radius_rad * np.sin(2 * np.pi * time_s / self.radial_period_s)
        turn = 2 * np.pi * time_s / self.turn_s
        return np.stack([radial * np.cos(turn), radial * np.sin(turn)])

    def extent_rad(self) -> float:
        """Compute the extent of the circle."""
        return self.radius_rad + self.box_extent_rad(0.0, 0.0)

    def half_width_rad(self) -> float:
        """Return the radius."""
        return self.radius_rad


def scene_daisy(section: DaisyScan, centre: FieldCentre, site: Site | None) -> Daisy:
    """Make the daisy of a section [scan]."""
    return Daisy(
        **figure_keys(section),
        radius_rad=section.radius_rad,
        radial_period_s=section.radial_period_s,
        turn_s=section.turn_s,
    )
