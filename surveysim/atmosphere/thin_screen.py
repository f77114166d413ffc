"""Closed forms and quadratures of the thin-screen atmosphere (paper, section on the Kolmogorov-Taylor model).

A flat layer of emission fluctuations has the isotropic two-dimensional power spectrum

    P(alpha) = B2 sin(el)^(1 - b) (alpha^2 + alpha_0^2)^(-b/2),    alpha_0 = 1 / outer_scale_rad,

with alpha in cycles per radian and a two-sided density in mK^2 rad^2. Without an outer scale alpha_0 = 0, and the
spectrum is the power law alpha^-b. Note that alpha_0 is one over the outer scale, without a factor 2 pi. The telescope
sees the layer in its near field, through a uniform disc of angular diameter D/h. Every function here is per unit
amplitude, B2 sin(el)^(1 - b) = 1; results scale with the amplitude.

At the elevation el the distance of the layer is h / sin(el): the disc has the width D sin(el) / h, and the outer scale
shrinks by the same factor. In angles over sin(el) the layer is that at the zenith, with the amplitude B2 / sin(el).

The paper takes angles to be small compared with a radian. A large outer scale may exceed one; the layer stays flat.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from math import gamma, inf, isfinite, pi, sin, sqrt

import numpy as np
from scipy.special import j0, j1, kv
from threadpoolctl import threadpool_limits

from surveysim.atmosphere.cubic_spline import CubicSpline
from surveysim.runtime.errors import OutOfRangeError

# In units of the beam: limits of the tabulated structure function, and the lag at which its two methods meet.
_LAG_MIN, _LAG_JOIN, LAG_MAX = 1e-4, 1.5, 1e4
# Above this the disc's transfer function is replaced by its average over an oscillation; the quarter cancels the
# first-order error.
_ALPHA_AVERAGED = 200.25
# End of the quadrature over alpha_y.
_ALPHA_Y_MAX = 300.25


@dataclass(frozen=True)
class Screen:
    """Thin layer as seen by one telescope.

    Attributes
    ----------
    index
        Spectral index b.
    beam_rad
        Angular diameter D/h of the disc.
    outer_scale_rad
        Outer scale; infinite for none.

    Raises
    ------
    ValueError
        Where no structure function exists (b <= 0, or b >= 4 without an outer scale), and for an outer scale smaller
        than the beam, for which the layer is not thin.
    """

    index: float
    beam_rad: float
    outer_scale_rad: float = inf

    def __post_init__(self) -> None:
        if not self.index > 0.0:
            raise OutOfRangeError(f"spectral index b = {self.index:g} found; b > 0 is allowed")
        if not (self.beam_rad > 0.0 and isfinite(self.beam_rad)):
            raise OutOfRangeError(f"beam_rad = {self.beam_rad:g} found; a positive finite angle D/h is allowed")
        if self.index >= 4.0 and not isfinite(self.outer_scale_rad):
            raise OutOfRangeError(
                f"spectral index b = {self.index:g} found without an outer scale: differences of the field"
                " would be infinite; b < 4 is allowed, or any b with a finite outer_scale_rad"
            )
        if not self.outer_scale_rad >= self.beam_rad:
            raise OutOfRangeError(
                f"outer_scale_rad = {self.outer_scale_rad:g} found; at least the beam, {self.beam_rad:g}, is allowed"
            )


def at_elevation(screen: Screen, sine: float) -> Screen:
    """Scale a screen at the zenith to an elevation with the given sine."""
    return replace(screen, beam_rad=screen.beam_rad * sine, outer_scale_rad=screen.outer_scale_rad * sine)


def power(screen: Screen, alpha: float | np.ndarray) -> np.ndarray:
    """Two-dimensional power spectrum of the layer without the beam [rad^2], at alpha [1/rad] of any shape."""
    return (np.square(alpha) + screen.outer_scale_rad**-2.0) ** (-screen.index / 2.0)


def beam_transfer(alpha_d: float | np.ndarray) -> np.ndarray:
    """Transfer function 2 J1(pi alpha D) / (pi alpha D) of a uniform disc; `alpha_d` is alpha times D."""
    argument = pi * np.maximum(np.abs(alpha_d), 1e-9)
    return 2.0 * j1(argument) / argument


# ---------------------------------------------------------------- structure function


def structure_function(screen: Screen, theta_rad: float | np.ndarray) -> np.ndarray:
    """Structure function <(T(r + theta) - T(r))^2> with the beam.

    D = 4 pi int alpha P beam^2 (1 - J0(2 pi alpha theta)) d alpha, from a cubic spline in log-log through a quadrature
    with an accuracy of about 1e-6. Below 1e-4 of the beam it continues as a power law.

    Parameters
    ----------
    screen
    theta_rad : any shape

    Returns
    -------
    array
        Of the shape of `theta_rad`, per unit amplitude.

    Raises
    ------
    ValueError
        Beyond 1e4 beams.
    """
    lag = np.abs(np.asarray(theta_rad, dtype=float)) / screen.beam_rad
    if np.any(lag > LAG_MAX):
        raise OutOfRangeError(f"angle of {lag.max():g} beams found; at most {LAG_MAX:g} is allowed")
    spline, slope_min = _log_structure(*_in_beams(screen))
    x = np.log(np.maximum(lag, 1e-300))
    below = np.minimum(x - np.log(_LAG_MIN), 0.0)
    value = screen.beam_rad ** (screen.index - 2.0) * np.exp(
        spline(np.maximum(x, np.log(_LAG_MIN))) + slope_min * below
    )
    return np.where(lag > 0.0, value, 0.0)


def structure_slope(screen: Screen, theta_rad: float | np.ndarray) -> np.ndarray:
    """Derivative of the structure function [1/rad] at angles `theta_rad` > 0 between 1e-4 and 1e4 beams."""
    spline, _ = _log_structure(*_in_beams(screen))
    x = np.log(np.asarray(theta_rad, dtype=float) / screen.beam_rad)
    return screen.beam_rad ** (screen.index - 2.0) * spline(x, 1) * np.exp(spline(x)) / theta_rad


@lru_cache(maxsize=16)  # realizations and layers of all observations have them in common
def structure_table(screen: Screen) -> tuple[np.ndarray, np.ndarray]:
    """Tabulate the structure function for `surveysim.atmosphere.trend_kernels.structure`.

    The table agrees with `structure_function` within 1e-7; beyond 1e4 beams it continues as a power law.

    Returns
    -------
    coefficients : (n, 4)
        Cubics in the squared angle, in equal cells for each factor of two, from 1e-4 to 1e4 beams. In a cell they are
        functions of the distance from its beginning, 0 to 1.
    scale : (3,)
        Squared beams per squared radian, and the powers of the squared angle below and above the table.
    """
    coefficients, powers = _table_in_beams(*_in_beams(screen))
    return coefficients * screen.beam_rad ** (screen.index - 2.0), np.append(screen.beam_rad**-2.0, powers)


@lru_cache(maxsize=64)
def _table_in_beams(index: float, outer_scale: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute `structure_table` for a beam of 1, and its powers (2,)."""
    from surveysim.atmosphere.trend_kernels import TABLE_CELLS, TABLE_OCTAVES

    spline, slope_min = _log_structure(index, outer_scale)
    ends = spline.x[[0, -1]]
    slopes = np.array([slope_min, float(spline(ends[1], 1))])
    octave = 2.0 ** np.arange(-TABLE_OCTAVES, TABLE_OCTAVES)
    squared = np.append((octave[:, None] * (1 + np.arange(TABLE_CELLS) / TABLE_CELLS)).ravel(), 2.0**TABLE_OCTAVES)
    x = 0.5 * np.log(squared)
    inside = np.clip(x, *ends)
    beyond = slopes[0] * np.minimum(x - ends[0], 0.0) + slopes[1] * np.maximum(x - ends[1], 0.0)
    value = np.exp(spline(inside) + beyond)
    # The cubic of Hermite in each cell, from values and derivatives at its ends.
    first, width = value * spline(inside, 1) / (2.0 * squared), np.diff(squared)
    rise, left, right = np.diff(value), first[:-1] * width, first[1:] * width
    cubics = [left + right - 2.0 * rise, 3.0 * rise - 2.0 * left - right, left, value[:-1]]
    return np.stack(cubics, axis=1), 0.5 * slopes


def _in_beams(screen: Screen) -> tuple[float, float]:
    """Index and outer scale in units of the beam, which determine the shape of the structure function."""
    # Rounded, so that one aperture at many heights gives one shape.
    return screen.index, float(f"{screen.outer_scale_rad / screen.beam_rad:.12g}")


def pencil_structure_function(index: float, theta_rad: float | np.ndarray) -> np.ndarray:
    """Structure function of the power law without a beam, for 2 < b < 4.

    D = 4 pi (2 pi theta)^(b-2) pi / (2^p Gamma((p+1)/2)^2 sin(pi (p-1)/2)), p = b - 1; about 300.6 theta^(5/3) for
    b = 11/3.

    Raises
    ------
    ValueError
        For any other b.
    """
    if not 2.0 < index < 4.0:
        raise OutOfRangeError(f"spectral index b = {index:g} found; a pencil beam allows 2 < b < 4")
    return _pencil_constant(index) * np.asarray(theta_rad, dtype=float) ** (index - 2.0)


def _pencil_constant(index: float) -> float:
    p = index - 1.0
    return (
        4.0 * pi * (2.0 * pi) ** (index - 2.0) * pi / (2.0**p * gamma((p + 1.0) / 2.0) ** 2 * sin(pi * (p - 1.0) / 2.0))
    )


@lru_cache(maxsize=64)
@threadpool_limits.wrap(limits=1)  # cached values must not depend on the number of threads
def _log_structure(index: float, outer_scale: float) -> tuple[Callable[..., np.ndarray], float]:
    """Spline of ln D against ln(theta / beam) for a beam of 1 and an outer scale in beams, and its slope at the lower
    end.
    """
    screen = Screen(index, 1.0, outer_scale)
    lag = np.geomspace(_LAG_MIN, LAG_MAX, 801)
    near = np.append(lag[lag < _LAG_JOIN], _LAG_JOIN)
    value_near = _structure_near(screen, near)
    far = lag[lag >= _LAG_JOIN]
    value_far = value_near[-1] + _structure_far(screen, far) - _structure_far(screen, np.array([_LAG_JOIN]))
    value = np.concatenate([value_near[:-1], value_far])
    spline = CubicSpline(np.log(lag), np.log(value))
    return spline, float(spline(np.log(_LAG_MIN), 1))


def _structure_near(screen: Screen, lag: np.ndarray) -> np.ndarray:
    """Integrate the spectrum for lags up to a few beams (in beams)."""
    b, scale = screen.index, screen.beam_rad ** (screen.index - 2.0)
    u0 = screen.beam_rad / screen.outer_scale_rad
    u_min = 1e-3 * min(u0, 1.0) if u0 > 0.0 else 1e-3
    u, weight = _gauss_panels(
        np.concatenate([np.geomspace(u_min, 0.25, 40), np.arange(0.5, _ALPHA_AVERAGED + 0.1, 0.25)]), 6
    )
    density = weight * u * (u * u + u0 * u0) ** (-b / 2.0) * beam_transfer(u) ** 2
    integral = _one_minus_j0(2.0 * pi * np.multiply.outer(lag, u)) @ density
    # Below u_min 1 - J0 is (pi u lag)^2; with an outer scale there is no power.
    head = (pi * lag) ** 2 * u_min ** (4.0 - b) / (4.0 - b) if u0 == 0.0 else 0.0
    return 4.0 * pi * scale * (integral + head + _structure_tail(b, lag))


def _structure_tail(b: float, lag: np.ndarray) -> np.ndarray:
    """Integrate above _ALPHA_AVERAGED, where beam^2 averages to 4 / (pi^4 u^3)."""
    x_min = _ALPHA_AVERAGED * lag
    x_max = np.maximum(x_min, 20.0)
    node, weight = np.polynomial.legendre.leggauss(300)
    half = 0.5 * np.log(x_max / x_min)
    x = x_min[:, None] * np.exp(np.multiply.outer(half, node + 1.0))
    inner = half * ((x ** (-1.0 - b) * _one_minus_j0(2.0 * pi * x)) @ weight)
    return 4.0 / pi**4 * lag ** (1.0 + b) * (inner + x_max ** (-1.0 - b) / (1.0 + b))


def _structure_far(screen: Screen, lag: np.ndarray) -> np.ndarray:
    """Structure function up to a constant, for lags above a beam (in beams).

    At these lags the beam averages the structure function of a pencil beam over the separations of two points of the
    disc (the autocorrelation of the disc); the average is smooth.
    """
    node, weight = np.polynomial.legendre.leggauss(24)
    root = 0.5 * (node + 1.0)  # s = 1 - root^2, because the overlap vanishes as (1 - s)^(3/2)
    s = 1.0 - root * root
    overlap = (np.arccos(s) - s * np.sqrt(1.0 - s * s)) * s * root * weight
    phi = (np.arange(24) + 0.5) * pi / 24.0
    distance = np.sqrt(lag[:, None, None] ** 2 + s[:, None] ** 2 + 2.0 * lag[:, None, None] * s[:, None] * np.cos(phi))
    return _pencil_difference(screen, distance).mean(axis=-1) @ (overlap / overlap.sum())


def _pencil_difference(screen: Screen, lag: np.ndarray) -> np.ndarray:
    """Structure function of a pencil beam up to a constant, for any allowed b, in units of the beam."""
    if isfinite(screen.outer_scale_rad):
        mu, argument = screen.index / 2.0 - 1.0, lag * screen.beam_rad
        alpha_0 = 1.0 / screen.outer_scale_rad
        bessel = kv(mu, 2.0 * pi * alpha_0 * argument)
        return -4.0 * pi / gamma(screen.index / 2.0) * (pi * argument / alpha_0) ** mu * bessel
    # At b = 2 the power law becomes a logarithm: the limit of (lag^p - 1) / p.
    p = screen.index - 2.0
    p = p if abs(p) > 1e-7 else 1e-7
    return _pencil_constant(p + 2.0) * np.expm1(p * np.log(lag)) * screen.beam_rad**p


def _one_minus_j0(x: np.ndarray) -> np.ndarray:
    """1 - J0(x) without cancellation at small x."""
    quarter = 0.25 * x * x
    return np.where(x < 0.05, quarter * (1.0 - quarter * (0.25 - quarter / 36.0)), 1.0 - j0(x))


def _gauss_panels(edges: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights of Gauss-Legendre quadrature on each panel between `edges`."""
    node, weight = np.polynomial.legendre.leggauss(order)
    half = 0.5 * np.diff(edges)
    return (edges[:-1] + half)[:, None].repeat(order, 1).ravel() + np.outer(half, node).ravel(), np.outer(
        half, weight
    ).ravel()


# ---------------------------------------------------------------- frozen flow


def temporal_psd(screen: Screen, f_hz: np.ndarray, speed_rad_s: float) -> np.ndarray:
    """One-sided PSD of the time stream of one beam under frozen flow [1/Hz], at `f_hz` > 0 of any shape."""
    return cross_psd(screen, f_hz, speed_rad_s, 0.0)


def cross_psd(screen: Screen, f_hz: np.ndarray, speed_rad_s: float, dy_rad: float) -> np.ndarray:
    """One-sided cross-PSD of two beams under frozen flow, separated across the wind.

    S(f, dy) = (2/w) int P beam^2 cos(2 pi alpha_y dy) d alpha_y over both signs, with alpha_x = f/w. It is real: a
    separation along the wind adds only a phase 2 pi f dx / w. The accuracy is 1e-5 for b = 11/3 (0.3 % for b = 2/3) up
    to f = 30 w / beam.

    Parameters
    ----------
    screen
    f_hz : any shape
        Positive frequencies.
    speed_rad_s
        Speed w of the layer.
    dy_rad
        Separation across the wind.

    Returns
    -------
    array
        Of the shape of `f_hz` [1/Hz].

    Raises
    ------
    ValueError
        For frequencies or a speed that are not positive.
    """
    f_hz = np.asarray(f_hz, dtype=float)
    if not (np.all(f_hz > 0.0) and speed_rad_s > 0.0):
        raise OutOfRangeError("frequency or speed that is not positive found; only positive ones are allowed")
    u_y, weight = _gauss_panels(
        np.concatenate([[0.0], np.geomspace(1e-7, 0.25, 60), np.arange(0.5, _ALPHA_Y_MAX, 0.25)]), 6
    )
    weight = weight * np.cos(2.0 * pi * u_y * dy_rad / screen.beam_rad)
    integral = [
        _transverse_integral(screen, u_x, u_y, weight) for u_x in np.ravel(f_hz) * screen.beam_rad / speed_rad_s
    ]
    return 4.0 / speed_rad_s * screen.beam_rad ** (screen.index - 1.0) * np.reshape(integral, f_hz.shape)


def _transverse_integral(screen: Screen, u_x: np.ndarray, u_y: np.ndarray, weight: np.ndarray) -> float:
    u0 = screen.beam_rad / screen.outer_scale_rad
    u_squared = u_x * u_x + u_y * u_y
    return np.sum(weight * (u_squared + u0 * u0) ** (-screen.index / 2.0) * beam_transfer(np.sqrt(u_squared)) ** 2)


def pencil_temporal_psd(index: float, f_hz: np.ndarray, speed_rad_s: float) -> np.ndarray:
    """One-sided temporal PSD of the power law without a beam [1/Hz], for b > 1.

    S = (2/w) (f/w)^(1-b) sqrt(pi) Gamma((b-1)/2) / Gamma(b/2).

    Raises
    ------
    ValueError
        For any other b.
    """
    if not index > 1.0:
        raise OutOfRangeError(f"spectral index b = {index:g} found; a pencil beam's PSD allows b > 1")
    constant = 2.0 * sqrt(pi) * gamma((index - 1.0) / 2.0) / gamma(index / 2.0)
    return constant / speed_rad_s * (np.asarray(f_hz, dtype=float) / speed_rad_s) ** (1.0 - index)


def mean_removed_variance(screen: Screen, speed_rad_s: float, duration_s: float) -> float:
    """Variance of a scan's time stream about the mean of the scan: int_0^1 (1 - x) D(x w T) dx."""
    node, weight = np.polynomial.legendre.leggauss(96)
    root = 0.5 * (node + 1.0)  # x = root^2 resolves the small lags
    x = root * root
    return float(np.sum(weight * root * (1.0 - x) * structure_function(screen, x * speed_rad_s * duration_s)))
