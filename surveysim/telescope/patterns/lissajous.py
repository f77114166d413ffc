"""Lissajous figures: sines along both axes, as of TolTEC's mapping patterns and SCUBA-2's simulator.

    x = A_x sin(2 pi t / T_x + phi),   y = A_y sin(2 pi t / T_y).

(Wilson et al. 2020, Proc. SPIE 11453, on TolTEC; its pattern has the full lengths 2 A and angular frequencies.) The
density of samples of a figure that takes long to close is the product of two arcsine densities,
1 / (pi^2 sqrt(A_x^2 - x^2) sqrt(A_y^2 - y^2)).
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.scan_figures import LissajousFigure, LissajousScan
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.patterns.figures import Figure, figure_keys, lissajous_curve


@dataclass(frozen=True, kw_only=True)
class Lissajous(Figure):
    """Lissajous figure of one observation."""

    figure: LissajousFigure

    def curve(self, time_s: np.ndarray) -> np.ndarray:
        """Compute the offsets (2, n)."""
        return lissajous_curve(self.figure, time_s)

    def extent_rad(self) -> float:
        """Compute the extent of the box that the figure fills."""
        return self.box_extent_rad(self.figure.amplitude_x_rad, self.figure.amplitude_y_rad)

    def half_width_rad(self) -> float:
        """Return the smaller amplitude."""
        return min(self.figure.amplitude_x_rad, self.figure.amplitude_y_rad)


def scene_lissajous(section: LissajousScan, centre: FieldCentre, site: Site | None) -> Lissajous:
    """Make the Lissajous figure of a section [scan]."""
    return Lissajous(**figure_keys(section), figure=section)
