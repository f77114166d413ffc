"""Correlation of the noise of overlapping pixels against their separation, for any illumination of the stop.

The coherence gamma of two pixels is the transform of the light in the plane of the stop
(`surveysim.telescope.illumination`). Within the aperture gamma has no power beyond one cycle per 2 (f/#)lambda and
gamma^2 none beyond one cycle per (f/#)lambda, and sums over a lattice of pixels are finite sums over its reciprocal
lattice (Poisson).
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.passband import Passband
from surveysim.telescope.illumination import UNIFORM, GaussianIllumination, Illumination

# Most detectors whose correlation is a dense matrix: a product with it then takes about 45 ns a sample, fields on a
# torus (`surveysim.telescope.lattice_noise`) 18 (gamma^2, pixels 1.3 apart) to 54 ns (gamma, 0.7 apart).
MOST_DENSE = 1500
# Separations closer than half of 10^-13 (f/#)lambda count as the same.
_SEPARATION_DECIMALS = 13

Kind = Literal["hbt", "field", "intensity", "none"]
Band = tuple[tuple[float, float], ...]  # frequencies over the one that (f/#)lambda refers to, and weights that sum to 1


@dataclass(frozen=True)
class PixelCoherence:
    """Correlation of one kind of noise between pixels, as a function of their separation.

    Attributes
    ----------
    kind
        "hbt" for the wave noise of photons: the square of the coherence that light through the aperture and light of
        the stop have together (Hill and Kusaka 2024, equations 59 and 60), averaged over the band. "field" for the
        coherence gamma of light through the aperture, "intensity" for its square, "none" for no correlation.
    illumination
        Beam of each pixel over the stop.
    band
        Frequencies and weights of the average of "hbt", for a beam of one efficiency. The weights are the squared
        transmission of the band, as of wave noise.
    with_stop
        Whether the stop emits. Without it "hbt" has one part.
    """

    kind: Kind
    illumination: Illumination = UNIFORM
    band: Band = ((1.0, 1.0),)
    with_stop: bool = False

    def parts(self, separation_f_lambda: np.ndarray) -> np.ndarray:
        """Correlation (n_part, ...) at separations of any shape, to 1e-11.

        "hbt" with the stop has three parts, the band's means of gamma_ap^2, gamma_ap gamma_stop and gamma_stop^2, to
        be added with the weights of `part_weights`. Their frequencies weigh by eta^2, eta (1 - eta) and (1 - eta)^2, as
        the wave noise does: horns spill less at high frequencies. Each part is positive semi-definite on any set of
        pixels: the coherences are transforms of non-negative intensities, and so are their products (Schur). Equal
        separations have equal correlations, to the last bit.
        """
        separation, which = np.unique(np.round(separation_f_lambda, _SEPARATION_DECIMALS), return_inverse=True)
        parts = self._distinct_parts(separation)
        return parts[:, which].reshape(len(parts), *np.shape(separation_f_lambda))

    def _distinct_parts(self, separation: np.ndarray) -> np.ndarray:
        if self.kind == "none":
            return (separation == 0).astype(float)[None]
        if self.kind != "hbt":
            gamma = self.illumination.aperture(separation)
            return (gamma if self.kind == "field" else gamma**2)[None]
        n_part = 3 if self.with_stop else 1
        total, light = np.zeros((n_part, len(separation))), np.zeros(n_part)
        for ratio, weight in self.band:
            beam, apart = self.illumination.at(ratio), separation * ratio
            eta, gamma = beam.efficiency, beam.aperture(apart)
            weights = weight * np.array([eta**2, eta * (1 - eta), (1 - eta) ** 2])[:n_part]
            light += weights
            total[0] += weights[0] * gamma**2
            if self.with_stop:
                stop = beam.stop(apart)
                total[1] += weights[1] * gamma * stop
                total[2] += weights[2] * stop**2
        return total / light[:, None]


def wave_noise_band(band: Passband) -> Band:
    """Make the frequencies, over the band's centre, and weights of averages of wave noise over a band.

    The noise of a load of one brightness at all frequencies is proportional to the square of the transmission. Gauss's
    quadrature for this weight averages correlations to 1e-6. Their phase over the band is 2 pi s times its
    relative width, and at large separations s they decrease as s^-3.
    """
    low, high = band.edges_hz
    frequency, weight = band.nodes
    weight = weight * band.at(frequency)
    return gauss_rule(
        frequency / band.centre_hz, weight / weight.sum(), 6 + math.ceil(30 * (high - low) / band.centre_hz)
    )


def gauss_rule(x: np.ndarray, weight: np.ndarray, n: int) -> Band:
    """Condense a quadrature with nodes (m,) and positive weights to n nodes, exact for polynomials to order 2 n - 1.

    The recursion of orthogonal polynomials (Stieltjes) gives a tridiagonal matrix, its eigenvalues are the nodes (Golub
    and Welsch 1969).
    """
    if len(x) <= n:
        return tuple(zip(x.tolist(), weight.tolist(), strict=True))
    before, now, diagonal, beside = np.zeros(len(x)), np.ones(len(x)), np.empty(n), np.zeros(n)
    for order in range(n):
        diagonal[order] = weight @ (x * now**2)
        after = (x - diagonal[order]) * now - beside[order - 1] * before
        beside[order] = np.sqrt(weight @ after**2)
        before, now = now, after / beside[order]
    nodes, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(beside[:-1], 1) + np.diag(beside[:-1], -1))
    return tuple(zip(nodes.tolist(), (vectors[0] ** 2).tolist(), strict=True))


def part_weights(stop_share: float | np.ndarray, n_part: int) -> np.ndarray:
    """Weights (n_part, ...) of the parts of `PixelCoherence.parts`; they sum to 1.

    `stop_share` is the stop's part ``w_stop / (w_ap + w_stop)`` of the light that overlapping pixels have in common.
    The weights are the terms of ``((1 - stop_share) gamma_ap + stop_share gamma_stop)^2``.
    """
    share = np.asarray(stop_share, dtype=float)
    return (
        np.stack([(1 - share) ** 2, 2 * share * (1 - share), share**2]) if n_part == 3 else np.ones((1, *share.shape))
    )


def correlation_matrices(
    positions_f_lambda: np.ndarray, coherence: PixelCoherence, angle_rad: np.ndarray | None = None
) -> np.ndarray:
    """Correlation (n_part, n_det, n_det) of noise between pixels at (n_det, 2) positions, by part.

    Detectors of one polarization at the angles `angle_rad` (n_det,) couple to the fraction cos(psi_i - psi_j) of each
    other's field, so that unpolarized light correlates their noise by ``cos^2(psi_i - psi_j)`` of it. (The difference
    of two orthogonal detectors in each pixel, Stokes Q, has ``cos 2(psi_i - psi_j)``: Hill and Kusaka's equation 62.)
    None for detectors with one angle, or of both polarizations.
    """
    positions = np.asarray(positions_f_lambda, dtype=float)
    one, other = np.tril_indices(len(positions), -1)  # by hand: scipy.spatial takes 0.1 s to import
    apart = np.hypot(*(positions[one] - positions[other]).T)
    parts = coherence.parts(apart)
    matrices = np.zeros((len(parts), len(positions), len(positions)))
    matrices[:, one, other] = parts
    matrices[:, other, one] = parts
    if angle_rad is not None:
        matrices *= np.cos(angle_rad[:, None] - angle_rad) ** 2
    matrices[:, np.arange(len(positions)), np.arange(len(positions))] = 1.0
    return matrices


@dataclass(frozen=True, eq=False)
class DensePixels:
    """Correlation of detectors by its parts (n_part, n_det, n_det); they add up with `part_weights`."""

    parts: np.ndarray

    def at(self, stop_share: float) -> "DenseCorrelation":
        """Diagonalize the correlation for one share of the stop. The last one is kept."""
        return _diagonalized(self, stop_share)

    def columns(self, rows: np.ndarray | slice) -> list[np.ndarray]:
        """Parts (n, n) for some of the detectors."""
        return [part[rows][:, rows] for part in self.parts]


@lru_cache(maxsize=1)  # most scenes have one share for all observations
@threadpool_limits.wrap(limits=1)  # no bit depends on the cores of the machine
def _diagonalized(pixels: DensePixels, stop_share: float) -> "DenseCorrelation":
    return overlap(np.tensordot(part_weights(stop_share, len(pixels.parts)), pixels.parts, axes=1))


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


def lattice_sum(pitch_f_lambda: float, coherence: str, illumination: GaussianIllumination = UNIFORM) -> float:
    """Sum of the coherence with all other pixels of an infinite hexagonal lattice: "field", "intensity" or "none".

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
