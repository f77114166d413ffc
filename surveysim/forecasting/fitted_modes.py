"""Modes in time that a fit of responsivities removes from the streams of a scan.

A responsivity c_i is the regression of a detector's stream on its template T(t). The cleaned stream is then orthogonal
to T: in addition to the spatial projection by the templates, each stream loses its component along one mode in time.
PCA does the same. T follows the layer, whose spectrum is so steep that T is nearly a straight line over the scan.

For Gaussian templates with the covariance sum_j lambda_j u_j u_j^T over a mean-removed scan, the expected projector is

    E[T T^T / |T|^2] = sum_j g_j u_j u_j^T,    g_j = E[lambda_j z_j^2 / sum_i lambda_i z_i^2],

with independent normal z: a fraction g_j of the scans loses the mode u_j. The modes are expanded in Legendre
polynomials over the scan; their Fourier transforms are spherical Bessel functions.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.forecasting.time_filters import LinearFilter

_MOST_DEGREES = 40  # with filters before the templates
_DEGREES = 8  # Legendre polynomials: a Kolmogorov layer has 1e-3 of its power in higher degrees
_SMALLEST = 1e-100  # argument of Bessel functions
_LEAST_SHARE = 0.03  # modes that fewer scans lose are omitted, some 5 % in all


@dataclass(frozen=True)
class FittedModes:
    """Orthonormal modes in time that responsivity fits remove.

    Attributes
    ----------
    share : (n,)
        Fraction of the scans that loses each mode.
    degrees : (n, N)
        Coefficients of each mode in Legendre polynomials of degree 1 to N, normalised over the scan.
    """

    share: np.ndarray
    degrees: np.ndarray

    @property
    def odd(self) -> np.ndarray:
        """Flags (n,): True for modes that are odd about the middle of the scan, False for even ones."""
        return np.any(self.degrees[:, ::2], axis=1)

    def at(self, time_s: np.ndarray, duration_s: float) -> np.ndarray:
        """Evaluate the modes (n, n_time) [s^-1/2] at times from the middle of a scan [s]."""
        from scipy.special import eval_legendre

        degree = np.arange(1, self.degrees.shape[1] + 1)[:, None]
        return self.degrees @ (np.sqrt((2 * degree + 1) / duration_s) * eval_legendre(degree, 2 * time_s / duration_s))

    def wave_components(self, frequency_hz: np.ndarray, duration_s: float) -> np.ndarray:
        """Project cos(2 pi f t) on the even modes and sin(2 pi f t) on the odd ones, (n_f, n) [s^1/2]."""
        return _wave_components(frequency_hz, duration_s, self.degrees.shape[1]) @ self.degrees.T

    def scaled(self, share: float) -> "FittedModes":
        """Scale the fraction of scans that loses each mode by `share`."""
        return FittedModes(self.share * share, self.degrees)


NO_FITTED_MODES = FittedModes(np.zeros(0), np.zeros((0, 1)))


def _wave_components(frequency_hz: np.ndarray, duration_s: float, n_degree: int) -> np.ndarray:
    """Project cosines (sines) on the normalised Legendre polynomials of even (odd) degree, (n_f, N) [s^1/2]."""
    degree, half_phase = np.arange(1, n_degree + 1), np.pi * np.asarray(frequency_hz) * duration_s
    sign = (-1.0) ** (degree // 2) * np.where(degree % 2, np.sign(half_phase)[:, None], 1.0)
    return sign * np.sqrt((2 * degree + 1) * duration_s) * _bessel(n_degree, np.abs(half_phase)).T


def _bessel(most: int, x: np.ndarray) -> np.ndarray:
    """Spherical Bessel functions (most, n) of degree 1 to `most` at x >= 0 (n,), by recurrence from the highest."""
    from scipy.special import spherical_jn

    found = np.empty((most + 1, len(x)))
    found[most], found[most - 1] = spherical_jn(most, x), spherical_jn(most - 1, x)
    positive = np.maximum(x, _SMALLEST)  # below it all are 0
    for n in range(most - 1, 0, -1):
        found[n - 1] = (2 * n + 1) / positive * found[n] - found[n + 1]
    return found[1:]


def template_modes(
    frequency_hz: np.ndarray, power: np.ndarray, duration_s: float, before: LinearFilter | None = None
) -> FittedModes:
    """Find the modes in time of templates with a given spectrum.

    Parameters
    ----------
    frequency_hz, power : (n,)
        Frequencies of the waves that a template is composed of, and their power.
    duration_s
        Length of a scan, whose mean is removed.
    before
        Filters in time that the templates have passed; None without any.

    Returns
    -------
    FittedModes
        Modes that more than 3 % of the scans lose.
    """
    n_degree = _DEGREES if before is None else min(_DEGREES + 2 * before.left.shape[1], _MOST_DEGREES)
    along = _wave_components(frequency_hz, duration_s, n_degree)
    covariance = along.T @ (power[:, None] * along)
    if before is not None:
        passed = _legendre_operator(before, n_degree)
        covariance = passed @ covariance @ passed.T
    values, fitted_modes = np.zeros(0), []
    for first in (0, 1):  # odd and even degrees do not mix
        found, vectors = np.linalg.eigh(covariance[first::2, first::2])
        values = np.concatenate([values, found])
        whole = np.zeros((len(found), n_degree))
        whole[:, first::2] = vectors.T
        fitted_modes.append(whole)
    share = expected_mode_shares(np.maximum(values, 0.0))
    kept = share > _LEAST_SHARE
    return FittedModes(share[kept], np.vstack(fitted_modes)[kept])


def _legendre_operator(of: LinearFilter, n_degree: int) -> np.ndarray:
    """Matrix (n_degree, n_degree) of a filter in Legendre polynomials from degree 1 on."""
    n_samp = len(of.left)
    place = (2 * np.arange(n_samp) + 1) / n_samp - 1
    basis = np.linalg.qr(np.polynomial.legendre.legvander(place, n_degree))
    # Signs as those of the polynomials.
    vectors = basis[0][:, 1:] * np.sign(np.diag(basis[1]))[1:]
    return vectors.T @ of.apply(vectors)


def expected_mode_shares(variance: np.ndarray) -> np.ndarray:
    """Expected fractions E[v_j z_j^2 / sum_i v_i z_i^2] for independent normal z.

    Evaluates ``int_0^inf v_j / (1 + 2 v_j s) prod_i (1 + 2 v_i s)^-1/2 ds``, from 1 / x = int_0^inf exp(-s x) ds.

    Parameters
    ----------
    variance : (n,)
        Variances v, of any common unit.

    Returns
    -------
    (n,) array
        Fractions, whose sum is 1.
    """
    v = variance / variance.sum()
    s = np.geomspace(1e-7, 1e12, 2000)
    factor = 1 + 2 * np.outer(s, v)
    with np.errstate(over="ignore"):  # of many modes, where the integrand is 0
        value = v / factor / np.sqrt(np.prod(factor, axis=1))[:, None]
    share = np.trapezoid(value * s[:, None], np.log(s), axis=0)
    return share / share.sum()
