"""Mixing of multipoles of a layer by the map's taper across the scans.

The taper along a scan is part of the leakage between frequencies (`surveysim.forecasting.scan_apodization`). Across it
the taper t spreads the noise N of map modes over |t(q)|^2, the power spectrum of its profile. Averaged over a bin and
over the directions u of the scans,

    N'_b = < sum over q of |t(q)|^2 N(|k + q u|) >.

Noise of a layer falls tenfold between neighbouring bins, above the multipole of the array's size after cleaning. N
goes as powers of ell between the bins.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from mapmaker.spectrum import tukey
from surveysim.reduction.scored_region import ScoredRegion
from surveysim.scene.analysis import Score

_TAPER_STEPS = 1024
_REACH, _STEPS = 12, 2  # cycles in the width of the taper, and nodes a cycle; 1 % of a box is beyond, less of others
_ANGLES, _ELLS = 16, 4  # of the scans, in half a turn, and nodes in a bin
_BETWEEN = 8  # multipoles a bin at which N is known
_LEAST = 1e-300  # of noise whose logarithm is finite


@dataclass(frozen=True, eq=False)
class ModeMixing:
    """Mixing of the noise of bins.

    Attributes
    ----------
    place : (n,)
        Each of some multipoles in numbers of bins: powers of ell between two bins.
    matrix : (n_bin, n)
        Weights of these multipoles in the bins; rows sum to 1.
    """

    place: np.ndarray
    matrix: np.ndarray

    def mixed(self, noise: np.ndarray) -> np.ndarray:
        """Mix noise (..., n_bin); bins without noise stay so."""
        logs, below = np.log(np.maximum(noise, _LEAST)), self.place.astype(int)
        above = np.minimum(below + 1, noise.shape[-1] - 1)
        between = logs[..., below] + (self.place - below) * (logs[..., above] - logs[..., below])
        return np.where(noise > 0, np.exp(between) @ self.matrix.T, 0.0)


def mode_mixing(region: ScoredRegion, score: Score) -> ModeMixing:
    """Mixing of the bins of a scored region by its taper."""
    ell, edges = region.rings.ell, region.rings.edges_ell
    at = np.linspace(edges[0], edges[-1], _BETWEEN * len(ell) + 1)
    place = np.interp(np.log(np.maximum(at, 1.0)), np.log(np.maximum(ell, 1.0)), np.arange(len(ell)))
    shift, power = taper_spectrum(score.size_rad, score.taper_fraction)
    rows = [_bin_weights(at, pair, shift, power) for pair in pairwise(edges.tolist())]
    return ModeMixing(place, np.array(rows))


def taper_spectrum(size_rad: float, taper_fraction: float) -> tuple[np.ndarray, np.ndarray]:
    """Shifts q (n,) [rad^-1] of modes by the profile of a taper, and its power spectrum at them, which sums to 1."""
    step = size_rad / _TAPER_STEPS
    profile = tukey(_TAPER_STEPS, step, size_rad, taper_fraction)
    shift = 2 * np.pi / size_rad / _STEPS * np.arange(-_REACH * _STEPS, _REACH * _STEPS + 1)
    place = step * (np.arange(_TAPER_STEPS) - (_TAPER_STEPS - 1) / 2)
    power = (np.cos(np.outer(shift, place)) @ profile) ** 2
    return shift, power / power.sum()


def _bin_weights(at: np.ndarray, edges: tuple[float, float], shift: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Weights of multipoles `at` (n,), evenly spaced, in a bin."""
    # Nodes of equal numbers of modes.
    parts = (np.arange(_ELLS) + 0.5) / _ELLS
    ell = np.sqrt(edges[0] ** 2 + parts * (edges[1] ** 2 - edges[0] ** 2))
    turn = np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    mode = np.exp(1j * turn)[:, None, None] * ell[:, None]
    place = np.clip((np.abs(mode + shift) - at[0]) / (at[1] - at[0]), 0, len(at) - 1.001).ravel()
    weight = np.tile(power, _ANGLES * _ELLS) / (_ANGLES * _ELLS)
    below = place.astype(int)
    above = (place - below) * weight
    return np.bincount(below, weight - above, len(at)) + np.bincount(below + 1, above, len(at))
