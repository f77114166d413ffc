"""Courses in time that cleaning takes from the streams of a scan when it fits responsivities to that scan.

A responsivity c_i is the regression of a detector's stream on its template T(t). The cleaned stream is then orthogonal
to T: beside the templates, which are a projection in space, each stream loses its component along one course in time.
PCA does the same, as a mode of a scan has a course. T is the layer's, whose spectrum falls so steeply that it is
mostly a straight line over the scan.

Of Gaussian templates with the covariance sum_j lambda_j u_j u_j^T over a scan less its mean, the expected projector is

    E[T T^T / |T|^2] = sum_j g_j u_j u_j^T,    g_j = E[lambda_j z_j^2 / sum_i lambda_i z_i^2],

with independent normal z: the share g_j of scans loses the course u_j. Courses are sums of Legendre polynomials over
the scan, whose transforms are spherical Bessel functions.
"""

from dataclasses import dataclass

import numpy as np

_DEGREES = 8  # of 1 and more: a Kolmogorov layer has 1e-3 of its power beyond
_LEAST_SHARE = 0.03  # of scans: courses that fewer lose are left out, some 5 % in all


@dataclass(frozen=True)
class Courses:
    """Orthonormal courses: `share` (n,) of the scans that lose each; `degrees` (n, N), in Legendre polynomials of
    degree 1 to N, normalised over the scan.
    """

    share: np.ndarray
    degrees: np.ndarray

    @property
    def odd(self) -> np.ndarray:
        """Whether each course (n,) is odd about the middle of a scan; the others are even."""
        return np.any(self.degrees[:, ::2], axis=1)

    def at(self, time_s: np.ndarray, duration_s: float) -> np.ndarray:
        """Values (n, n_time) [s^-1/2] at times from the middle of a scan."""
        from scipy.special import eval_legendre

        degree = np.arange(1, self.degrees.shape[1] + 1)[:, None]
        return self.degrees @ (np.sqrt((2 * degree + 1) / duration_s) * eval_legendre(degree, 2 * time_s / duration_s))

    def of_waves(self, frequency_hz: np.ndarray, duration_s: float) -> np.ndarray:
        """Components (n_f, n) [s^1/2] of cos(2 pi f t) along even courses and of sin(2 pi f t) along odd ones."""
        return _of_waves(frequency_hz, duration_s, self.degrees.shape[1]) @ self.degrees.T

    def less(self, share: float) -> "Courses":
        """The same courses lost by a share of these scans alone."""
        return Courses(self.share * share, self.degrees)


NO_COURSES = Courses(np.zeros(0), np.zeros((0, 1)))


def _of_waves(frequency_hz: np.ndarray, duration_s: float, n_degree: int) -> np.ndarray:
    """Components (n_f, N) of cosines, or sines, along normalised Legendre polynomials of even, or odd, degree."""
    from scipy.special import spherical_jn

    degree, half_phase = np.arange(1, n_degree + 1), np.pi * np.asarray(frequency_hz)[:, None] * duration_s
    sign = (-1.0) ** (degree // 2) * np.where(degree % 2, np.sign(half_phase), 1.0)
    return sign * np.sqrt((2 * degree + 1) * duration_s) * spherical_jn(degree, np.abs(half_phase))


def template_courses(frequency_hz: np.ndarray, power: np.ndarray, duration_s: float) -> Courses:
    """Courses of a template that is made of waves (n,) with a `power` each, over scans less their mean."""
    along = _of_waves(frequency_hz, duration_s, _DEGREES)
    covariance = along.T @ (power[:, None] * along)
    values, courses = np.zeros(0), []
    for first in (0, 1):  # odd and even degrees do not mix
        found, vectors = np.linalg.eigh(covariance[first::2, first::2])
        values = np.concatenate([values, found])
        whole = np.zeros((len(found), _DEGREES))
        whole[:, first::2] = vectors.T
        courses.append(whole)
    share = expected_shares(np.maximum(values, 0.0))
    kept = share > _LEAST_SHARE
    return Courses(share[kept], np.vstack(courses)[kept])


def expected_shares(variance: np.ndarray) -> np.ndarray:
    """E[v_j z_j^2 / sum_i v_i z_i^2] (n,) of independent normal z, with variances v; their sum is 1.

    ``int_0^inf v_j / (1 + 2 v_j s) prod_i (1 + 2 v_i s)^-1/2 ds``, as 1 / x = int_0^inf exp(-s x) ds.
    """
    v = variance / variance.sum()
    s = np.geomspace(1e-7, 1e12, 2000)
    factor = 1 + 2 * np.outer(s, v)
    value = v / factor / np.sqrt(np.prod(factor, axis=1))[:, None]
    share = np.trapezoid(value * s[:, None], np.log(s), axis=0)
    return share / share.sum()
