"""Lissajous figures: sines along both axes, as of TolTEC's mapping patterns and SCUBA-2's simulator.

    x = A_x sin(2 pi t / T_x + phi),   y = A_y sin(2 pi t / T_y).

(Wilson et al. 2020, Proc. SPIE 11453, on TolTEC; its pattern has the full lengths 2 A and angular frequencies.) The
density of samples of a figure that takes long to close is the product of two arcsine densities,
1 / (pi^2 sqrt(A_x^2 - x^2) sqrt(A_y^2 - y^2)).
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.scan_figures import LissajousScan
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.patterns.figures import Figure, figure_keys


@dataclass(frozen=True, kw_only=True)
class Lissajous(Figure):
    """Lissajous figure of one observation: amplitudes and periods along x and y, and the phase of x at the start."""

    amplitudes_rad: tuple[float, float]
    periods_s: tuple[float, float]
    phase_rad: float

    def curve(self, time_s: np.ndarray) -> np.ndarray:
        """Compute the offsets (2, n)."""
        (x_rad, y_rad), (x_s, y_s) = self.amplitudes_rad, self.periods_s
        x = x_rad * np.sin(2 * np.pi * time_s / x_s + self.phase_rad)
        return np.stack([x, y_rad * np.sin(2 * np.pi * time_s / y_s)])

    def extent_rad(self) -> float:
        """Compute the extent of the box that the figure fills."""
        return self.box_extent_rad(*self.amplitudes_rad)

    def half_width_rad(self) -> float:
        """Return the smaller amplitude."""
        return min(self.amplitudes_rad)


def scene_lissajous(section: LissajousScan, centre: FieldCentre, site: Site | None) -> Lissajous:
    """Make the Lissajous figure of a section [scan]."""
    return Lissajous(
        **figure_keys(section),
        amplitudes_rad=(section.amplitude_x_rad, section.amplitude_y_rad),
        periods_s=(section.period_x_s, section.period_y_s),
        phase_rad=section.phase_rad,
    )
