"""Correlation between detectors that the thin screen predicts for mean-removed scans (paper, section 3.2)."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from math import inf, pi, sin

import numpy as np

from surveysim.atmosphere.thin_screen import Screen, structure_function

_ORIENTATIONS, _NODES = 8, 32
_SEPARATIONS = 13  # in the table, from 0 on
OUTER_SCALE_M = 10_000.0


def scan_correlation(screen: Screen, theta_rad: np.ndarray, track_rad: float) -> np.ndarray:
    """Correlation C(theta) between two detectors over a mean-removed scan, per unit amplitude.

    With the structure function D, which includes beam and height, and the track L of the layer during the scan,

        C = int_0^1 (1 - x) D(|r + x L|) dx - D(r) / 2,

    averaged over the angle between r and L. At r = 0 it is the variance of a scan about its mean.

    Parameters
    ----------
    screen
    theta_rad : (n,)
        Separations |r|.
    track_rad
        Length |L| of the track.

    Returns
    -------
    (n,) array
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
    """C(theta) on a grid of spectral indices, heights and tracks, per unit amplitude.

    Attributes
    ----------
    index : (n_b,)
        Spectral indices b.
    height_m : (n_h,)
    theta_rad : (n_bin,)
        Separations of the result.
    node_rad : (n_node,)
        Separations of the table.
    spline
        Cubic spline in ln(track) for a layer at the zenith, with values (n_b, n_h, n_track, n_node + 1): ln C(0), then
        the ratios C(theta) / C(0). At other elevations the layer is the same in angles over sin(el).
    """

    index: np.ndarray
    height_m: np.ndarray
    theta_rad: np.ndarray
    node_rad: np.ndarray
    spline: Callable[[np.ndarray], np.ndarray]

    def correlation(self, track_rad: np.ndarray, elevation_rad: np.ndarray) -> np.ndarray:
        """Mean C over the scans of an observation, per unit B2.

        Parameters
        ----------
        track_rad, elevation_rad : (n_scan,)
            Track of the layer during each scan, and elevation.

        Returns
        -------
        (n_b, n_h, n_bin) array
            NaN for tracks and separations outside the grid.
        """
        from scipy.interpolate import CubicSpline

        sine = np.sin(elevation_rad)
        values = self.spline(np.log(track_rad / sine))
        at_nodes = (np.exp(values[..., :1]) / sine[:, None] * values[..., 1:]).mean(axis=2)
        if not np.isfinite(at_nodes).all():
            return np.full((*at_nodes.shape[:2], len(self.theta_rad)), np.nan)
        # The elevations of an observation are nearly equal.
        return CubicSpline(self.node_rad, at_nodes, axis=-1, extrapolate=False)(self.theta_rad / sine.mean())


def correlation_grid(
    theta_rad: np.ndarray,
    *,
    index: Sequence[float],
    height_m: Sequence[float],
    aperture_m: float,
    outer_scale_m: float | None,
    track_rad: np.ndarray,
    lowest_rad: float = pi / 2,
) -> CorrelationGrid:
    """Tabulate C(theta) for every index and height.

    Parameters
    ----------
    theta_rad : (n_bin,)
        Separations.
    index : (n_b,)
        Spectral indices; those of 4 and more need an outer scale, which is `OUTER_SCALE_M` by default.
    height_m : (n_h,)
    aperture_m
    outer_scale_m
        None for no outer scale.
    track_rad : (n_track,)
        Knots of the spline, increasing.
    lowest_rad
        Lowest elevation of the observations.
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
