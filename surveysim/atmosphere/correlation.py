"""Correlation between detectors that the thin screen predicts, for scans whose mean is removed (paper, section 3.2)."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, pi

import numpy as np

from surveysim.atmosphere.spectrum import Screen, structure_function

_ORIENTATIONS, _NODES = 8, 32
OUTER_SCALE_M = 10_000.0


def scan_correlation(screen: Screen, theta_rad: np.ndarray, track_rad: float) -> np.ndarray:
    """C(theta) [1] of two detectors `theta_rad` (n,) apart over a scan, the mean of each removed, per unit amplitude.

    The layer moves by `track_rad` during the scan. With D the structure function, which has beam and height
    in it, ``C = int_0^1 (1 - x) D(|r + x L|) dx - D(r) / 2``, averaged over the angle between r and L; at r = 0 it is
    the variance of a scan about its mean.
    """
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    x = (0.5 * (node + 1.0)) ** 2  # resolves the small lags
    weight = weight * np.sqrt(x) * (1.0 - x)
    angle = (np.arange(_ORIENTATIONS) + 0.5) * pi / _ORIENTATIONS
    theta, moved = np.asarray(theta_rad)[:, None, None], track_rad * x
    apart = np.sqrt(theta**2 + moved**2 + 2.0 * theta * moved * np.cos(angle)[:, None])
    return structure_function(screen, apart).mean(axis=1) @ weight - 0.5 * structure_function(screen, theta_rad)


@dataclass(frozen=True)
class CorrelationGrid:
    """C(theta) on a grid of indices (n_b,), heights (n_h,) [m] and tracks, per unit amplitude.

    `theta_rad` (n_bin,); `spline` is cubic in ln track, its values (n_b, n_h, n_bin + 1): ln C(0), then the ratios
    C(theta) / C(0).
    """

    index: np.ndarray
    height_m: np.ndarray
    theta_rad: np.ndarray
    spline: object

    def correlation(self, track_rad: np.ndarray) -> np.ndarray:
        """C (n_b, n_h, n_bin), the mean over scans with tracks `track_rad` (n_scan,); NaN for those off the grid."""
        values = self.spline(np.log(track_rad))
        return (np.exp(values[..., :1]) * values[..., 1:]).mean(axis=2)


def correlation_grid(
    theta_rad: np.ndarray,
    index: Sequence[float],
    height_m: Sequence[float],
    aperture_m: float,
    outer_scale_m: float | None,
    track_rad: np.ndarray,
) -> CorrelationGrid:
    """Tabulate C(theta) for every index and height; `track_rad` (n,) are the knots of its spline, increasing.

    Without an outer scale, indices of 4 and more have one of `OUTER_SCALE_M`: they need one.
    """
    from scipy.interpolate import CubicSpline

    theta = np.concatenate([[0.0], theta_rad])
    values = np.array(
        [
            [scan_correlation(_screen(b, h, aperture_m, outer_scale_m), theta, track) for track in track_rad]
            for b, h in product(index, height_m)
        ]
    ).reshape(len(index), len(height_m), len(track_rad), len(theta))
    values[..., 1:] /= values[..., :1]
    values[..., 0] = np.log(values[..., 0])
    spline = CubicSpline(np.log(track_rad), values, axis=2, extrapolate=False)
    return CorrelationGrid(np.array(index), np.array(height_m), np.asarray(theta_rad), spline)


def _screen(index: float, height_m: float, aperture_m: float, outer_scale_m: float | None) -> Screen:
    if outer_scale_m is None:
        outer_scale_m = OUTER_SCALE_M if index >= 4 else inf
    return Screen(index, aperture_m / height_m, outer_scale_m / height_m)
