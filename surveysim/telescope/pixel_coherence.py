"""(f/#)lambda overlap: how much of a beam-filling source two pixels share, for any illumination of the stop.

Two pixels see the stop with a phase that turns s times across its diameter when they are s (f/#)lambda apart.
Their mutual coherence gamma(s) is the transform of the intensity with which a pixel lights the stop (van
Cittert and Zernike). So gamma has no power beyond one cycle in two (f/#)lambda and gamma^2 none beyond one cycle
in one, and sums over a lattice of pixels are finite sums over its reciprocal lattice (Poisson).
"""

import math
from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import OutOfRangeError

# Of the radius of a corrugated horn's aperture, the waist of the Gaussian beam it launches (Goldsmith 1998).
_WAIST_PER_RADIUS = 0.6435
# Beyond this exponent (174 dB) the stop's edge cuts off less than rounding.
_UNTRUNCATED = 40.0
# Detectors up to which a correlation is a matrix of all pairs: a product with it takes some 45 ns a sample then, fields
# on a torus (`surveysim.telescope.lattice_noise`) 18 (coherence "intensity", pixels 1.3 apart) to 54 ("field", 0.7).
MOST_DENSE = 1500
# Separations closer than half of 10^-13 (f/#)lambda count as the same.
_SEPARATION_DECIMALS = 13


@dataclass(frozen=True)
class Illumination:
    """Illumination of the stop by a pixel: intensity ``10^(-T/10 u^2)`` at the share u of the stop's radius.

    `edge_taper_db` is T; 0 lights the stop uniformly. Raises ValueError unless it is finite and 0 or more.
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


# ---------------------------------------------------------------- horns


def horn_taper_db(diameter_f_lambda: float) -> float:
    """Edge taper [dB] that a horn with an aperture `diameter_f_lambda` wide gives: 8.9 dB at 2, 1.1 dB at 0.7.

    The fundamental Gaussian beam of waist w0 spreads as ``exp(-2 (theta pi w0 / lambda)^2)``; the stop's edge is
    at ``theta = 1 / (2 f/#)``. Goldsmith, Quasioptical Systems (1998), for corrugated horns; others with a
    symmetric beam come close. Small angles. Raises ValueError unless the diameter is finite and 0 or more.
    """
    if not 0 <= diameter_f_lambda < math.inf:
        raise OutOfRangeError(
            f"diameter_f_lambda = {diameter_f_lambda:g} found; a finite diameter of 0 or more is allowed"
        )
    waist = _WAIST_PER_RADIUS * diameter_f_lambda / 2
    return 10 / math.log(10) * 2 * (math.pi * waist / 2) ** 2


def stop_efficiency(edge_taper_db: float) -> float:
    """Share of a horn's beam that passes the stop, ``1 - 10^(-T/10)``; what remains ends on the cold stop.

    For horns only: 0 dB is the limit of a horn so small that the stop catches nothing of its wide beam.
    Raises ValueError for a taper that is negative or not finite.
    """
    return -math.expm1(-Illumination(edge_taper_db).exponent)


# ---------------------------------------------------------------- coherence


def mutual_coherence(separation_f_lambda: np.ndarray, illumination: Illumination = Illumination()) -> np.ndarray:
    """Field coherence gamma, of the shape given, of pixels s (f/#)lambda apart: ``int I J0(pi s u) u du / int I u du``.

    A uniformly lit stop gives ``2 J1(pi s) / (pi s)``: 0.506 at 0.7 (f/#)lambda, the paper's "50 % of the power
    received by adjacent bolometers is completely correlated" (section 5.1). A taper adds the Zernike modes of the
    Gaussian, each of which transforms to a Bessel function (Nijboer), good to 1e-13 at any separation.
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
    """(2m + 1, weight of J_(2m+1)) for m = 1, 2, ... beside a weight of 1 for J1, down to rounding.

    ``exp(-y t) = sum (2m + 1) (-1)^m i_m(y) P_m(t)``, t = 2 u^2 - 1, and ``P_m(t)`` transforms to
    ``(-1)^m J_(2m+1)(x) / x``; i_m are modified spherical Bessel functions.
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
    """Correlation (n_det, n_det) of a beam-filling source between pixels at (n_det, 2) positions.

    `coherence` is "field" (gamma), "intensity" (gamma^2, Hanbury Brown and Twiss) or "none".
    All three are positive semi-definite: gamma is the transform of the lit stop, and a product of such
    functions is one again. Equal separations have equal correlations, to the last bit.
    """
    from scipy.spatial.distance import pdist, squareform

    positions = np.asarray(positions_f_lambda, dtype=float)
    if coherence == "none":
        return np.eye(len(positions))
    matrix = squareform(coherence_at(pdist(positions), coherence, illumination))
    np.fill_diagonal(matrix, 1.0)
    return matrix


def coherence_at(separation_f_lambda: np.ndarray, coherence: str, illumination: Illumination) -> np.ndarray:
    """Correlation at separations of any shape, to 1e-11; arguments as for `correlation_matrix`."""
    separation, which = np.unique(np.round(separation_f_lambda, _SEPARATION_DECIMALS), return_inverse=True)
    if coherence == "none":
        return (separation == 0).astype(float)[which].reshape(separation_f_lambda.shape)
    gamma = _interpolated_coherence(separation, illumination)
    return (gamma if coherence == "field" else gamma**2)[which].reshape(separation_f_lambda.shape)


def _interpolated_coherence(separation: np.ndarray, illumination: Illumination) -> np.ndarray:
    """`mutual_coherence` of many separations (n,) to 1e-11, for less than n series of Bessel functions.

    Gamma has no power beyond one cycle in two (f/#)lambda, so its Chebyshev coefficients over separations up to S
    vanish, as those of a cosine do, soon beyond the order pi S / 2.
    """
    order = math.pi / 2 * separation.max(initial=0.0)
    degree = math.ceil(order + 12 * order ** (1 / 3) + 20)
    if illumination.edge_taper_db == 0 or len(separation) <= degree:
        return mutual_coherence(separation, illumination)
    domain = [0.0, separation.max()]
    return np.polynomial.Chebyshev.interpolate(mutual_coherence, degree, domain, args=(illumination,))(separation)


@dataclass(frozen=True, eq=False)
class DenseCorrelation:
    """A correlation C of detectors by its eigenvalues (n_det,) and eigenvectors (n_det, n_det)."""

    values: np.ndarray
    vectors: np.ndarray

    def factor(self, share: float = 1.0) -> np.ndarray:
        """The symmetric root A (n_det, n_det) of ``share C + (1 - share) I``.

        Of all factors it is the one that depends on nothing but the matrix, continuously: the same deviates give
        nearly the same streams for nearly the same optics, however eigenvectors of equal eigenvalues are chosen.
        """
        half = self.vectors * (share * self.values + (1 - share)) ** 0.25
        return half @ half.T


def overlap(correlation: np.ndarray) -> DenseCorrelation:
    """The modes of a correlation matrix (n_det, n_det).

    Densely packed pixels share modes and make the matrix nearly singular, where Cholesky fails.
    Raises ValueError when an eigenvalue is negative beyond rounding.
    """
    values, vectors = np.linalg.eigh(correlation)
    limit = 1e-10 * max(values[-1], 1.0) * len(values)
    if not values[0] >= -limit:
        raise OutOfRangeError(f"correlation matrix has the eigenvalue {values[0]:.3g}; none below 0 is allowed")
    return DenseCorrelation(np.clip(values, 0, None), vectors)


def correlation_factor(correlation: np.ndarray) -> np.ndarray:
    """The symmetric root of a correlation matrix, ``A A^T = correlation``; errors as `overlap`."""
    return overlap(correlation).factor()


# ---------------------------------------------------------------- lattices


def lattice_sum(pitch_f_lambda: float, coherence: str, illumination: Illumination = Illumination()) -> float:
    """Coherence with all other pixels of an infinite hexagonal lattice, summed; `coherence` as for a matrix.

    One more than this is how much more noise the array's mean has than were its pixels independent. Exact, by
    Poisson's formula: the transform of the coherence at the points of the reciprocal lattice, over the cell.
    A uniformly lit stop and intensity give ``8 / (pi sqrt(3) p^2) - 1`` up to p = 2 / sqrt(3), where the first
    reciprocal points come within a stop's diameter: 2.00 at 0.7, 0.47 at 1.0, 0.07 at 1.2.
    The sum of the field is one over ever larger circles, and jumps where reciprocal points cross the stop's edge.
    Raises ValueError unless the pitch is positive and finite.
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
    """Intensity on the stop, of unit integral, at `frequency` (n,) in stop diameters from its centre."""
    from scipy.special import exprel

    inside = np.minimum(frequency, 0.5)
    intensity = np.exp(-4 * exponent * inside**2) / (math.pi / 4 * exprel(-exponent))
    return np.where(frequency < 0.5, intensity, 0.0)


def _stop_autocorrelation(frequency: np.ndarray, exponent: float) -> np.ndarray:
    """Autocorrelation of that intensity at shifts of `frequency` (n,) stop diameters; 0 from one diameter on.

    The product of both Gaussians is one about the middle of the lens in which the stops overlap; over the lens's
    radius the integral is closed, over the angle it is Gauss-Legendre.
    """
    from scipy.special import exprel

    node, weight = np.polynomial.legendre.leggauss(96)
    phi = math.pi / 4 * (node + 1)
    half = np.minimum(frequency, 1.0)[:, None] / 2
    radius = np.sqrt(0.25 - (half * np.sin(phi)) ** 2) - half * np.cos(phi)
    lens = (2 * radius**2 * exprel(-8 * exponent * radius**2)) @ weight * (math.pi / 4)
    return lens * np.exp(-2 * exponent * frequency**2) / (math.pi / 4 * exprel(-exponent)) ** 2
