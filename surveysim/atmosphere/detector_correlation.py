"""Correlation between detectors that the thin screen predicts, for scans whose mean is removed (paper, section 3.2)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, pi, sin

import numpy as np

from surveysim.atmosphere.thin_screen import Screen, structure_function

_ORIENTATIONS, _NODES = 8, 32
_SEPARATIONS = 13  # of a grid, from none on
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

    `theta_rad` (n_bin,). `spline` is that of a layer at the zenith, cubic in ln track, with values (n_b, n_h, n_track,
    n_node + 1): ln C(0), then the ratios C(theta) / C(0) at separations `node_rad` (n_node,). At other elevations it is
    the same layer in angles over sin(el).
    """

    index: np.ndarray
    height_m: np.ndarray
    theta_rad: np.ndarray
    node_rad: np.ndarray
    spline: Callable[[np.ndarray], np.ndarray]

    def correlation(self, track_rad: np.ndarray, elevation_rad: np.ndarray) -> np.ndarray:
        """C (n_b, n_h, n_bin) per unit B2, the mean over scans with tracks (n_scan,) at elevations (n_scan,).

        NaN for tracks and separations off the grid.
        """
        from scipy.interpolate import CubicSpline

        sine = np.sin(elevation_rad)
        values = self.spline(np.log(track_rad / sine))
        at_nodes = (np.exp(values[..., :1]) / sine[:, None] * values[..., 1:]).mean(axis=2)
        if not np.isfinite(at_nodes).all():
            return np.full((*at_nodes.shape[:2], len(self.theta_rad)), np.nan)
        # An observation's elevations are nearly one.
        return CubicSpline(self.node_rad, at_nodes, axis=-1, extrapolate=False)(self.theta_rad / sine.mean())


def correlation_grid(
    theta_rad: np.ndarray,
    index: Sequence[float],
    height_m: Sequence[float],
    aperture_m: float,
    outer_scale_m: float | None,
    track_rad: np.ndarray,
    *,
    lowest_rad: float = pi / 2,
) -> CorrelationGrid:
    """Tabulate C(theta) for every index and height; `track_rad` (n,) are the knots of its spline, increasing.

    Elevations from `lowest_rad` on are allowed. Without an outer scale, indices of 4 and more have one of
    `OUTER_SCALE_M`: they need one.
    """
    from scipy.interpolate import CubicSpline

    node = np.linspace(0.0, 1.01 * theta_rad.max() / sin(lowest_rad), _SEPARATIONS)
    values = np.array(
        [
            [scan_correlation(_screen(b, h, aperture_m, outer_scale_m), node, track) for track in track_rad]
            for b, h in product(index, height_m)
        ]
    ).reshape(len(index), len(height_m), len(track_rad), len(node))
    level = values[..., :1]
    values = np.concatenate([np.log(level), values / level], axis=-1)
    spline = CubicSpline(np.log(track_rad), values, axis=2, extrapolate=False)
    return CorrelationGrid(np.array(index), np.array(height_m), np.asarray(theta_rad), node, spline)


def _screen(index: float, height_m: float, aperture_m: float, outer_scale_m: float | None) -> Screen:
    if outer_scale_m is None:
        outer_scale_m = OUTER_SCALE_M if index >= 4 else inf
    return Screen(index, aperture_m / height_m, outer_scale_m / height_m)
