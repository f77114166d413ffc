"""Mutual coherence of overlapping pixels for a beam-filling source, for any illumination of the stop.

Two pixels s (f/#)lambda apart see the stop with a phase that turns s times across its diameter. Their mutual coherence
gamma(s) is the Fourier transform of the illumination of the stop (van Cittert-Zernike). So gamma has no power beyond
one cycle per 2 (f/#)lambda and gamma^2 none beyond one cycle per (f/#)lambda, and sums over a lattice of pixels are
finite sums over its reciprocal lattice (Poisson).
"""

import math
from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import OutOfRangeError

# Waist of the Gaussian beam of a corrugated horn, over the radius of its aperture (Goldsmith 1998).
_WAIST_PER_RADIUS = 0.6435
# Beyond this exponent (174 dB) truncation by the stop is below rounding.
_UNTRUNCATED = 40.0
# Most detectors whose correlation is a dense matrix: a product with it then takes about 45 ns a sample, fields on a
# torus (`surveysim.telescope.lattice_noise`) 18 ("intensity", pixels 1.3 apart) to 54 ns ("field", 0.7 apart).
MOST_DENSE = 1500
# Separations closer than half of 10^-13 (f/#)lambda count as the same.
_SEPARATION_DECIMALS = 13


@dataclass(frozen=True)
class Illumination:
    """Illumination of the stop by a pixel: intensity ``10^(-T/10 u^2)`` at the fraction u of the stop's radius.

    `edge_taper_db` is T; 0 is uniform illumination. Raises OutOfRangeError unless it is finite and 0 or more.
    """

    edge_taper_db: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.edge_taper_db < math.inf:
            raise OutOfRangeError(
                f"edge_taper_db = {self.edge_taper_db:g} found; a finite taper of 0 dB or more is allowed"
            )

    @property
    def exponent(self) -> float:
        """Kappa of the intensity ``exp(-kappa u^2)``."""
        return self.edge_taper_db * math.log(10) / 10

    def intensity(self, rho: np.ndarray) -> np.ndarray:
        """Intensity at radii `rho` over the stop's, relative to the centre's."""
        return np.exp(-self.exponent * np.square(rho))


# ---------------------------------------------------------------- horns


def horn_taper_db(diameter_f_lambda: float) -> float:
    """Edge taper [dB] of a horn with an aperture of `diameter_f_lambda`: 8.9 dB at 2, 1.1 dB at 0.7.

    The fundamental Gaussian beam of waist w0 spreads as ``exp(-2 (theta pi w0 / lambda)^2)``; the edge of the stop is
    at ``theta = 1 / (2 f/#)``. Valid for corrugated horns (Goldsmith, Quasioptical Systems, 1998), approximately for
    other horns with a symmetric beam, and for small angles. Raises OutOfRangeError unless the diameter is finite and 0
    or more.
    """
    if not 0 <= diameter_f_lambda < math.inf:
        raise OutOfRangeError(
            f"diameter_f_lambda = {diameter_f_lambda:g} found; a finite diameter of 0 or more is allowed"
        )
    waist = _WAIST_PER_RADIUS * diameter_f_lambda / 2
    return 10 / math.log(10) * 2 * (math.pi * waist / 2) ** 2


def stop_efficiency(edge_taper_db: float) -> float:
    """Fraction of a horn's beam that passes the stop, ``1 - 10^(-T/10)``; the rest ends on the cold stop.

    For horns only: 0 dB is the limit of a small horn with a beam so wide that nothing passes the stop. Raises
    OutOfRangeError for a taper that is negative or not finite.
    """
    return -math.expm1(-Illumination(edge_taper_db).exponent)


# ---------------------------------------------------------------- coherence


def mutual_coherence(separation_f_lambda: np.ndarray, illumination: Illumination = Illumination()) -> np.ndarray:
    """Field coherence gamma of pixels s (f/#)lambda apart: ``int I J0(pi s u) u du / int I u du``.

    A uniformly illuminated stop gives ``2 J1(pi s) / (pi s)``: 0.506 at 0.7 (f/#)lambda, the paper's "50 % of the power
    received by adjacent bolometers is completely correlated" (section 5.1). A taper adds Zernike modes of the Gaussian.
    Each transforms to a Bessel function (Nijboer); the sum is good to 1e-13 at any separation.
    """
    from scipy.special import j1, jv

    x = np.pi * np.asarray(separation_f_lambda, dtype=float)
    if illumination.exponent > _UNTRUNCATED:
        return np.exp(-(x**2) / (4 * illumination.exponent))
    safe = np.where(x == 0, 1.0, x)
    total = j1(safe)
    for order, weight in _zernike_weights(illumination.exponent / 2):
        total += weight * jv(order, safe)
    return np.where(x == 0, 1.0, 2 * total / safe)


def _zernike_weights(half_exponent: float) -> list[tuple[int, float]]:
    """Pairs (2m + 1, weight of J_(2m+1)) for m = 1, 2, ..., relative to a weight of 1 for J1, down to rounding.

    ``exp(-y t) = sum (2m + 1) (-1)^m i_m(y) P_m(t)``, t = 2 u^2 - 1, and ``P_m(t)`` transforms to ``(-1)^m J_(2m+1)(x)
    / x``; i_m are modified spherical Bessel functions.
    """
    from scipy.special import ive

    if half_exponent == 0:
        return []
    m = np.arange(1, 60)
    weight = (2 * m + 1) * ive(m + 0.5, half_exponent) / ive(0.5, half_exponent)
    kept = weight > 1e-16
    return list(zip((2 * m[kept] + 1).tolist(), weight[kept].tolist(), strict=True))


def correlation_matrix(
    positions_f_lambda: np.ndarray, coherence: str, illumination: Illumination = Illumination()
) -> np.ndarray:
    """Correlation (n_det, n_det) of the noise of a beam-filling source between pixels at (n_det, 2) positions.

    `coherence` is "field" (gamma), "intensity" (gamma^2, Hanbury Brown and Twiss) or "none". All three are positive
    semi-definite: gamma is the transform of a non-negative function, and products of such functions are positive
    semi-definite too. Equal separations have equal correlations, to the last bit.
    """
    from scipy.spatial.distance import pdist, squareform

    positions = np.asarray(positions_f_lambda, dtype=float)
    if coherence == "none":
        return np.eye(len(positions))
    matrix = squareform(coherence_at(pdist(positions), coherence, illumination))
    np.fill_diagonal(matrix, 1.0)
    return matrix


def coherence_at(separation_f_lambda: np.ndarray, coherence: str, illumination: Illumination) -> np.ndarray:
    """Compute the correlation at separations of any shape, to 1e-11; arguments as for `correlation_matrix`."""
    separation, which = np.unique(np.round(separation_f_lambda, _SEPARATION_DECIMALS), return_inverse=True)
    if coherence == "none":
        return (separation == 0).astype(float)[which].reshape(separation_f_lambda.shape)
    gamma = _interpolated_coherence(separation, illumination)
    return (gamma if coherence == "field" else gamma**2)[which].reshape(separation_f_lambda.shape)


def _interpolated_coherence(separation: np.ndarray, illumination: Illumination) -> np.ndarray:
    """Compute `mutual_coherence` at many separations (n,), to 1e-11, by Chebyshev interpolation.

    Gamma has no power beyond one cycle per 2 (f/#)lambda. Like a cosine's, its Chebyshev coefficients over separations
    up to S vanish soon beyond the order pi S / 2.
    """
    order = math.pi / 2 * separation.max(initial=0.0)
    degree = math.ceil(order + 12 * order ** (1 / 3) + 20)
    if illumination.edge_taper_db == 0 or len(separation) <= degree:
        return mutual_coherence(separation, illumination)
    domain = [0.0, separation.max()]
    return np.polynomial.Chebyshev.interpolate(mutual_coherence, degree, domain, args=(illumination,))(separation)


@dataclass(frozen=True, eq=False)
class DenseCorrelation:
    """Correlation C of detectors by its eigenvalues (n_det,) and eigenvectors (n_det, n_det)."""

    values: np.ndarray
    vectors: np.ndarray

    def factor(self, share: float = 1.0) -> np.ndarray:
        """Symmetric square root (n_det, n_det) of ``share C + (1 - share) I``.

        Unlike other factors it depends continuously on the matrix alone, not on the choice of eigenvectors for equal
        eigenvalues: the same deviates give nearly the same streams for nearly the same optics.
        """
        half = self.vectors * (share * self.values + (1 - share)) ** 0.25
        return half @ half.T


def overlap(correlation: np.ndarray) -> DenseCorrelation:
    """Diagonalize a correlation matrix (n_det, n_det).

    Densely packed pixels make the matrix nearly singular, where Cholesky decomposition fails. Raises OutOfRangeError if
    an eigenvalue is negative beyond rounding.
    """
    values, vectors = np.linalg.eigh(correlation)
    limit = 1e-10 * max(values[-1], 1.0) * len(values)
    if not values[0] >= -limit:
        raise OutOfRangeError(f"correlation matrix has the eigenvalue {values[0]:.3g}; none below 0 is allowed")
    return DenseCorrelation(np.clip(values, 0, None), vectors)


def correlation_factor(correlation: np.ndarray) -> np.ndarray:
    """Symmetric square root of a correlation matrix, ``A A^T = correlation``; errors as `overlap`."""
    return overlap(correlation).factor()


# ---------------------------------------------------------------- lattices


def lattice_sum(pitch_f_lambda: float, coherence: str, illumination: Illumination = Illumination()) -> float:
    """Sum of the coherence with all other pixels of an infinite hexagonal lattice; `coherence` as for
    `correlation_matrix`.

    The noise of the array's mean is one plus this sum times the noise of independent pixels. Exact, by Poisson's
    formula: the sum of the coherence's transform at the reciprocal lattice, divided by the area of a cell. Uniform
    illumination and "intensity" give ``8 / (pi sqrt(3) p^2) - 1`` up to p = 2 / sqrt(3), where the first reciprocal
    points come within a stop's diameter: 2.00 at 0.7, 0.47 at 1.0, 0.07 at 1.2. The sum for "field" is the limit over
    growing circles, and jumps where reciprocal points cross the edge of the stop. Raises OutOfRangeError unless the
    pitch is positive and finite.
    """
    if not 0 < pitch_f_lambda < math.inf:
        raise OutOfRangeError(f"pitch_f_lambda = {pitch_f_lambda:g} found; a positive finite pitch is allowed")
    if coherence == "none":
        return 0.0
    reach = math.ceil(pitch_f_lambda)
    q, r = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
    rings, points = np.unique(q * q + q * r + r * r, return_counts=True)
    frequency = 2 / math.sqrt(3) / pitch_f_lambda * np.sqrt(rings)
    transform = _stop_intensity if coherence == "field" else _stop_autocorrelation
    cell = math.sqrt(0.75) * pitch_f_lambda**2
    return float(points @ transform(frequency, illumination.exponent)) / cell - 1


def _stop_intensity(frequency: np.ndarray, exponent: float) -> np.ndarray:
    """Intensity on the stop, with unit integral, at `frequency` (n,) in stop diameters from its centre."""
    from scipy.special import exprel

    inside = np.minimum(frequency, 0.5)
    intensity = np.exp(-4 * exponent * inside**2) / (math.pi / 4 * exprel(-exponent))
    return np.where(frequency < 0.5, intensity, 0.0)


def _stop_autocorrelation(frequency: np.ndarray, exponent: float) -> np.ndarray:
    """Autocorrelation of the stop intensity at shifts of `frequency` (n,) stop diameters; 0 from one diameter on.

    The product of the two Gaussians is a Gaussian about the middle of the lens where the stops overlap. The radial
    integral is in closed form, the angular one by Gauss-Legendre quadrature.
    """
    from scipy.special import exprel

    node, weight = np.polynomial.legendre.leggauss(96)
    phi = math.pi / 4 * (node + 1)
    half = np.minimum(frequency, 1.0)[:, None] / 2
    radius = np.sqrt(0.25 - (half * np.sin(phi)) ** 2) - half * np.cos(phi)
    lens = (2 * radius**2 * exprel(-8 * exponent * radius**2)) @ weight * (math.pi / 4)
    return lens * np.exp(-2 * exponent * frequency**2) / (math.pi / 4 * exprel(-exponent)) ** 2
