"""Pong scans: diagonals that bounce within a box, with corners rounded by a Fourier series.

The curvy pong of SCUBA-2 (Holland et al. 2013, MNRAS 430, 2513; "The impact of scanning pattern strategies on uniform
sky coverage of large maps", SCUBA-2 note SC2/ANA/S210/008), as JCMT and FYST compute it. Vertices are
sqrt(2) times the spacing apart on all sides; their numbers N_x and N_y are coprime and one of them is even, so that the
track passes all of them before it closes, after N_x N_y 2 sqrt(2) spacings along each axis. Along an axis the boresight
follows the first terms of a triangle wave of amplitude A = N sqrt(2) spacing / 2 and period T = 4 A sqrt(2) / velocity:

    x = (8 A / pi^2) sum_k (-1)^k sin((2 k + 1) 2 pi t / T) / (2 k + 1)^2.

Without rounding the density of samples is uniform in the box.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.scan_figures import PongScan
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.patterns.figures import Figure, figure_keys


@dataclass(frozen=True, kw_only=True)
class Pong(Figure):
    """Pong of one observation: amplitudes and periods of the triangle waves along x and y, and their terms."""

    amplitudes_rad: tuple[float, float]
    periods_s: tuple[float, float]
    terms: int

    def curve(self, time_s: np.ndarray) -> np.ndarray:
        """Compute the offsets (2, n)."""
        waves = [triangle_wave(time_s / period, self.terms) for period in self.periods_s]
        return np.stack(waves) * np.array(self.amplitudes_rad)[:, None]

    def extent_rad(self) -> float:
        """Compute the extent of the box; rounded corners stay within it."""
        return self.box_extent_rad(*self.amplitudes_rad)

    def half_width_rad(self) -> float:
        """Return the smaller amplitude."""
        return min(self.amplitudes_rad)


def scene_pong(section: PongScan, centre: FieldCentre, site: Site | None) -> Pong:
    """Make the pong of a section [scan]."""
    return Pong(
        **figure_keys(section),
        amplitudes_rad=section.amplitudes_rad,
        periods_s=section.periods_s,
        terms=section.terms,
    )


def triangle_wave(periods: np.ndarray, terms: int) -> np.ndarray:
    """Sum the first terms of the Fourier series of a triangle wave of unit amplitude at times (n,), in periods."""
    found = np.zeros_like(periods)
    for number in range(terms):
        odd = 2 * number + 1
        found += (-1) ** number * np.sin(2 * np.pi * odd * periods) / odd**2
    return 8 / np.pi**2 * found
