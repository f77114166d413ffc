"""Overlap of pixels against quadrature over the stop, horns against their beams, lattices against direct sums."""

import tracemalloc

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.special import j0, roots_legendre

from surveysim.telescope.illumination import UNIFORM, GaussianIllumination, He11Illumination, gaussian_horn
from surveysim.telescope.layouts import hexagon
from surveysim.telescope.pixel_coherence import correlation_factor, lattice_sum
from tests.pixels import correlation_matrix

DENSE = pytest.mark.parametrize("pitch", [0.1, 0.7, 1.3])
COHERENCES = pytest.mark.parametrize("coherence", ["field", "intensity", "none"])
OVERLAPS = pytest.mark.parametrize("coherence", ["field", "intensity"])
TAPERS = pytest.mark.parametrize("taper_db", [0.0, 3.0, 10.0, 30.0])


@pytest.fixture
def rng():
    return np.random.default_rng(51)


def test_values_of_the_paper():
    assert UNIFORM.aperture(0.0) == 1
    assert UNIFORM.aperture(0.7) == pytest.approx(0.506, abs=5e-4)  # section 5.1: 50 % for neighbours
    # First zeros of J1 at 3.8317 and 7.0156, over pi: Airy's 1.22 and 2.23.
    assert UNIFORM.aperture(np.array([3.8317059702, 7.0155866698]) / np.pi) == pytest.approx([0, 0], abs=1e-9)
    assert UNIFORM.aperture(1.21) > 0 > UNIFORM.aperture(1.23)


def test_small_separations_are_smooth():
    """gamma = 1 - (pi s)^2 / 8 + ..., without trouble at or near 0; even in s."""
    s = np.array([1e-12, 1e-6, 1e-3])
    np.testing.assert_allclose(UNIFORM.aperture(s), 1 - (np.pi * s) ** 2 / 8, rtol=1e-12)
    np.testing.assert_array_equal(UNIFORM.aperture(-s), UNIFORM.aperture(s))


def stop_quadrature(s):
    """Mean of cos(2 pi s x) over a uniformly lit disc of diameter 1, by quadrature in both directions."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    radius, of_radius = (nodes + 1) / 4, weights / 4 * (nodes + 1) / 4
    angle = np.arange(240) * 2 * np.pi / 240
    phase = 2 * np.pi * s * radius[:, None] * np.cos(angle)
    return np.sum(of_radius[:, None] * np.cos(phase)) * (2 * np.pi / 240) / (np.pi / 4)


@pytest.mark.parametrize("s", [0.0, 0.1, 0.7, 1.0, 1.3, 2.5, 8.4])
def test_van_cittert_zernike(s):
    """Pixels s (f/#)lambda apart see the stop with a phase that turns s times across its diameter."""
    # Both quadratures converge exponentially at these orders.
    assert UNIFORM.aperture(s) == pytest.approx(stop_quadrature(s), abs=1e-13)


def taper_quadrature(s, taper_db):
    """gamma at separations (n,), by Gauss-Legendre over the stop's radius; 600 nodes hold 2 pi * 600 / 2 > 500 pi."""
    node, weight = roots_legendre(600)
    u = (node + 1) / 2
    weight = weight * u * 10 ** (-taper_db / 10 * u * u)
    return j0(np.pi * np.multiply.outer(s, u)) @ weight / weight.sum()


@pytest.mark.parametrize("taper_db", [0.0, 1e-9, 0.1, 3.0, 10.0, 30.0, 100.0, 173.0, 174.0, 300.0])
def test_tapered_stop(taper_db):
    s = np.concatenate([np.linspace(0, 20, 201), np.geomspace(21, 500, 50)])
    np.testing.assert_allclose(
        GaussianIllumination(taper_db).aperture(s), taper_quadrature(s, taper_db), rtol=0, atol=1e-12
    )


@TAPERS
def test_small_separations_of_a_tapered_stop(taper_db):
    """gamma = 1 - (pi s)^2 <u^2> / 4 + ..., <u^2> = 1 / kappa - 1 / (e^kappa - 1), 1 / 2 if uniform."""
    kappa = GaussianIllumination(taper_db).exponent
    mean_square = 1 / kappa - 1 / np.expm1(kappa) if kappa else 0.5
    s = np.array([0, 1e-9, 1e-3, 1e-2])
    # The next term is (pi s)^4 <u^4> / 64, and 1 is good to rounding.
    rest = GaussianIllumination(taper_db).aperture(s) - 1 + (np.pi * s) ** 2 * mean_square / 4
    assert np.all(abs(rest) < 0.6 * s**4 + 1e-15)
    assert GaussianIllumination(taper_db).aperture(0.0) == 1


@pytest.mark.parametrize("taper_db", [10.0, 30.0, 60.0, 100.0])
def test_strong_taper_is_a_gaussian(taper_db):
    """Without the stop's edge exp(-(pi s)^2 / 4 kappa); what the edge cuts off is e^-kappa of either integral."""
    s = np.linspace(0, 10, 201)
    kappa = GaussianIllumination(taper_db).exponent
    beyond = abs(GaussianIllumination(taper_db).aperture(s) - np.exp(-((np.pi * s) ** 2) / (4 * kappa)))
    assert 0.1 * np.exp(-kappa) < beyond.max() < 2 * np.exp(-kappa) + 1e-13


def test_weak_taper_is_uniform():
    """The intensity differs by kappa at most, so do numerator and denominator."""
    s = np.linspace(0, 10, 201)
    for taper_db in (1e-12, 1e-6, 1e-2):
        tapered = GaussianIllumination(taper_db).aperture(s)
        assert np.all(abs(tapered - UNIFORM.aperture(s)) < 2 * GaussianIllumination(taper_db).exponent + 1e-15)


@pytest.mark.parametrize("taper_db", [-0.1, np.inf, np.nan])
def test_no_such_taper(taper_db):
    with pytest.raises(ValueError, match="edge_taper_db = .* found; a finite taper of 0 dB or more"):
        GaussianIllumination(taper_db)


def test_horn_taper():
    """At 2 (f/#)lambda the waist is 0.6435, pi w0 / 2 = 1.0108, and exp(-2 * 1.0217) = 0.1296 is -8.87 dB."""
    assert gaussian_horn(2.0).edge_taper_db == pytest.approx(8.87, abs=0.005)
    assert gaussian_horn(0.7).edge_taper_db == pytest.approx(8.87 * 0.35**2, abs=0.002)
    for diameter in (-1.0, 0.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="diameter_f_lambda = .* found; a finite diameter"):
            gaussian_horn(diameter)
        with pytest.raises(ValueError, match="diameter_f_lambda = .* found; a finite diameter"):
            He11Illumination(diameter)


def test_waist_of_a_corrugated_horn():
    """The Gaussian that overlaps most, 98 %, with the field J0(2.405 r / a) of a corrugated horn's aperture.

    The paraxial far field is the transform: the beam's intensity at the stop's edge follows from either.
    """

    def overlap(waist):
        cross = quad(lambda r: j0(2.404826 * r) * np.exp(-((r / waist) ** 2)) * r, 0, 1)[0]
        return cross**2 / (quad(lambda r: (j0(2.404826 * r)) ** 2 * r, 0, 1)[0] * waist**2 / 4)

    best = minimize_scalar(lambda waist: -overlap(waist), bounds=(0.3, 1.0), method="bounded", options={"xatol": 1e-9})
    assert -best.fun == pytest.approx(0.98, abs=0.002)
    assert best.x == pytest.approx(0.6435, abs=5e-4)
    field = quad(lambda r: np.exp(-((r / (best.x * 0.5 * 2.0)) ** 2)) * j0(np.pi * r) * r, 0, 8)[0]
    centre = quad(lambda r: np.exp(-((r / (best.x * 0.5 * 2.0)) ** 2)) * r, 0, 8)[0]
    assert -20 * np.log10(field / centre) == pytest.approx(gaussian_horn(2.0).edge_taper_db, rel=2e-3)


@pytest.mark.parametrize("taper_db", [0.1, 3.0, 10.9, 30.0])
def test_efficiency_of_a_tapered_stop(taper_db):
    """Against quadrature of the field E = 10^(-T/20 u^2) over the stop and to infinity."""

    def disc(power, radius):
        return quad(lambda u: 10 ** (-power * taper_db / 20 * u * u) * 2 * u, 0, radius, limit=200)[0]

    wide = np.sqrt(400 / taper_db)  # to 400 dB
    assert GaussianIllumination(taper_db).efficiency == pytest.approx(disc(2, 1) / disc(2, wide), rel=1e-7)


@DENSE
@COHERENCES
def test_matrix(pitch, coherence):
    positions = hexagon(4, pitch)
    matrix = correlation_matrix(positions, coherence)
    np.testing.assert_array_equal(matrix, matrix.T)
    np.testing.assert_array_equal(np.diagonal(matrix), 1)
    separation = np.hypot(*(positions[3] - positions[17]))
    expected = {
        "field": stop_quadrature(separation),
        "intensity": stop_quadrature(separation) ** 2,
        "none": 0,
    }
    assert matrix[3, 17] == pytest.approx(expected[coherence], abs=1e-12)


@pytest.mark.parametrize("pitch", [0.1, 0.3, 0.7, 1.3, 3.0, 10.0])
@TAPERS
@OVERLAPS
def test_positive_semi_definite(coherence, taper_db, pitch):
    """1 to 397 pixels of a lattice; elements are good to 1e-12, so that eigenvalues are to n times that at worst."""
    for rings in (0, 1, 4, 11):
        matrix = correlation_matrix(hexagon(rings, pitch), coherence, GaussianIllumination(taper_db))
        assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * len(matrix)


@TAPERS
@OVERLAPS
def test_positive_semi_definite_off_lattices(rng, coherence, taper_db):
    """300 pixels at random, ten to the square of (f/#)lambda, so that the least eigenvalue is rounding."""
    matrix = correlation_matrix(rng.uniform(0, 5.5, (300, 2)), coherence, GaussianIllumination(taper_db))
    assert abs(np.linalg.eigvalsh(matrix)[0]) < 1e-12 * len(matrix)


def test_few_modes_in_a_small_array():
    """Area of the array times that of the stop, 61 * 0.0087 * pi / 4 = 0.41 modes, and those of its edge."""
    values = np.linalg.eigvalsh(correlation_matrix(hexagon(4, 0.1), "field"))
    assert values[-1] > 0.5 * values.sum() and (values > 1e-3).sum() < 15


@TAPERS
def test_matrix_of_many_separations(rng, taper_db):
    """Interpolated in separation where that pays, as for 45 distinct ones of 10 pixels it does not."""
    for n, extent in ((10, 30), (60, 1), (60, 100)):
        positions = rng.uniform(0, extent, (n, 2))
        separation = np.linalg.norm(positions[:, None] - positions[None, :], axis=-1)
        expected = GaussianIllumination(taper_db).aperture(separation)
        matrix = correlation_matrix(positions, "field", GaussianIllumination(taper_db))
        # Polynomials of order 300 amplify rounding by about as much.
        np.testing.assert_allclose(matrix, expected, rtol=0, atol=1e-11)


def test_equal_separations_have_equal_correlations():
    """To the last bit, though their positions differ by rounding: 19 pixels of a lattice have 8 separations."""
    matrix = correlation_matrix(hexagon(2, 0.7) + 1 / 3, "intensity", GaussianIllumination(8.9))
    assert len(np.unique(matrix)) == 1 + 8


@DENSE
@COHERENCES
def test_factor(pitch, coherence):
    matrix = correlation_matrix(hexagon(4, pitch), coherence, GaussianIllumination(3.0))
    factor = correlation_factor(matrix)
    np.testing.assert_array_equal(factor, factor.T)
    # Eigenvectors are orthogonal to some eps n, and what is clipped of these matrices is rounding.
    np.testing.assert_allclose(factor @ factor.T, matrix, rtol=0, atol=1e-12)
    assert np.linalg.eigvalsh(factor)[0] > -1e-10


@DENSE
@OVERLAPS
def test_factor_is_continuous(coherence, pitch):
    """``|A - B| <= |A^2 - B^2|^(1/2)`` for roots of positive matrices, in the spectral norm (Bhatia, X.1.1)."""
    positions = hexagon(4, pitch)
    matrix = correlation_matrix(positions, coherence)
    for change in (1e-2, 1e-4, 1e-6):
        other = correlation_matrix(positions * (1 + change), coherence, GaussianIllumination(change))
        moved = np.linalg.norm(correlation_factor(other) - correlation_factor(matrix), 2)
        # Rounding of eigenvalues near 0, some 1e-15, has a root too.
        assert 0 < moved < np.sqrt(np.linalg.norm(other - matrix, 2)) + 1e-6


@OVERLAPS
def test_factor_knows_no_order(rng, coherence):
    """A lattice has equal eigenvalues, between whose eigenvectors there is a choice; the root does not see it."""
    matrix = correlation_matrix(hexagon(3, 0.7), coherence)
    values = np.linalg.eigvalsh(matrix)
    assert np.sum(np.diff(values) < 1e-12 * values[1:]) >= 5
    order = rng.permutation(len(matrix))
    there = np.ix_(order, order)
    # Eigenvalues down to about 2e-3 of the largest: their roots are good to some 1e-13.
    np.testing.assert_allclose(correlation_factor(matrix[there]), correlation_factor(matrix)[there], atol=1e-11)


def test_memory_of_2000_detectors():
    """A matrix of 32 MB, the separations of half of it and their order."""
    positions = hexagon(26, 1.0)[:2000]
    tracemalloc.start()
    matrix = correlation_matrix(positions, "intensity", GaussianIllumination(10.0))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert matrix.shape == (2000, 2000) and peak < 150e6


def test_a_matrix_that_is_no_correlation_is_refused():
    with pytest.raises(ValueError, match="has the eigenvalue -0.2.*none below 0 is allowed"):
        correlation_factor(np.array([[1, 1.2], [1.2, 1]]))
    with pytest.raises(ValueError, match="eigenvalue"):
        correlation_factor(np.array([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]))
    with pytest.raises(ValueError, match="eigenvalue nan"):
        correlation_factor(np.array([[1, np.nan], [np.nan, 1]]))


def lattice(rings):
    """Distances from a pixel of a hexagonal lattice to all others, up to `rings` pitches; (n,), and their counts."""
    q, r = np.meshgrid(np.arange(-2 * rings, 2 * rings + 1), np.arange(-2 * rings, 2 * rings + 1))
    square = q * q + q * r + r * r
    distance, count = np.unique(square[(square > 0) & (square <= rings**2)], return_counts=True)
    return np.sqrt(distance), count


@pytest.mark.parametrize("pitch, expected", [(0.7, 2.00), (1.0, 0.47), (1.2, 0.07)])
def test_shared_power_of_a_lattice(pitch, expected):
    """Noise that a whole lattice shares: 2.00, 0.47, 0.07 at 0.7, 1.0, 1.2 (f/#)lambda."""
    assert lattice_sum(pitch, "intensity") == pytest.approx(expected, abs=0.005)
    if pitch < 2 / np.sqrt(3):
        assert lattice_sum(pitch, "intensity") == pytest.approx(8 / (np.pi * np.sqrt(3) * pitch**2) - 1, rel=1e-12)


@pytest.mark.parametrize("pitch", [0.5, 1.0, 1.2, 2.0, 3.3])
@TAPERS
def test_lattice_sum_of_intensity(taper_db, pitch):
    """Against the direct sum to 300 pitches R and the mean of what lies beyond.

    Far away gamma is that of the stop's edge, a 2 J1(x) / x with a = kappa / (e^kappa - 1), and J1(x)^2 is
    1 / (pi x) on average, so that the pixels beyond hold 8 a^2 / (pi^3 R cell) all in all.
    """
    kappa = GaussianIllumination(taper_db).exponent
    edge = kappa / np.expm1(kappa) if kappa else 1.0
    beyond = 8 * edge**2 / (np.pi**3 * 300 * pitch * np.sqrt(0.75) * pitch**2)
    distance, count = lattice(300)
    total = count @ GaussianIllumination(taper_db).aperture(distance * pitch) ** 2 + beyond
    assert lattice_sum(pitch, "intensity", GaussianIllumination(taper_db)) == pytest.approx(
        total, abs=0.1 * beyond + 1e-9
    )


@pytest.mark.parametrize("pitch", [0.5, 1.155, 1.2, 2.0, 3.3, 10.0])
def test_lattice_sum_of_uniform_stops(pitch):
    """Poisson's formula with the overlap of two discs in closed form (the optical transfer function)."""
    reach = np.arange(-12, 13)
    q, r = np.meshgrid(reach, reach)
    k = np.minimum(np.sqrt(q * q + q * r + r * r) / (np.sqrt(0.75) * pitch), 1)
    overlap = 2 / np.pi * (np.arccos(k) - k * np.sqrt(1 - k * k))
    expected = np.sum(overlap) * (4 / np.pi) / (np.sqrt(0.75) * pitch**2)
    assert lattice_sum(pitch, "intensity") + 1 == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("pitch", [0.5, 1.2, 3.3, 10.0])
def test_lattice_sum_of_gaussians(pitch):
    """At 120 dB, where the direct sum of exp(-(pi s)^2 / 4 kappa) and of its square ends within 20 (f/#)lambda."""
    illumination = GaussianIllumination(120.0)
    distance, count = lattice(40)
    gamma = np.exp(-((np.pi * distance * pitch) ** 2) / (4 * illumination.exponent))
    # The stop's edge cuts off 1e-12.
    assert lattice_sum(pitch, "field", illumination) == pytest.approx(count @ gamma, rel=1e-10, abs=1e-10)
    assert lattice_sum(pitch, "intensity", illumination) == pytest.approx(count @ gamma**2, rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("pitch", [0.8, 1.7, 3.3])
@TAPERS
def test_lattice_sum_of_field(taper_db, pitch):
    """Against the direct sum with a Gaussian cut-off exp(-(s / R)^2), R = 40 (f/#)lambda.

    The cut-off smooths the stop by a Gaussian of variance v = 1 / (2 pi^2 R^2) per axis; the lit stop's is
    1 / (8 kappa), so that each term changes by no more than a share 8 kappa v (1 + 4 kappa k^2), 4 k^2 < 1.
    """
    distance, count = lattice(int(np.ceil(240 / pitch)))
    s = distance * pitch
    total = count @ (GaussianIllumination(taper_db).aperture(s) * np.exp(-((s / 40) ** 2)))
    kappa = GaussianIllumination(taper_db).exponent
    share = 8 * kappa / (2 * np.pi**2 * 40**2) * (1 + kappa)
    exact = lattice_sum(pitch, "field", GaussianIllumination(taper_db))
    assert abs(total - exact) < share * (exact + 1) + 1e-9


@TAPERS
def test_lattice_sum_of_dense_pixels(taper_db):
    """A continuous plane, the stop's (auto)correlation at 0: int I^2 / (int I)^2, and I(0) / int I."""
    kappa = GaussianIllumination(taper_db).exponent
    mean = -np.expm1(-kappa) / kappa if kappa else 1.0
    mean_square = -np.expm1(-2 * kappa) / (2 * kappa) if kappa else 1.0
    cell, stop = np.sqrt(0.75) * 0.1**2, np.pi / 4
    field = lattice_sum(0.1, "field", GaussianIllumination(taper_db))
    intensity = lattice_sum(0.1, "intensity", GaussianIllumination(taper_db))
    assert field + 1 == pytest.approx(1 / (mean * stop * cell), rel=1e-12)
    assert intensity + 1 == pytest.approx(mean_square / (mean**2 * stop * cell), rel=1e-12)


def test_lattice_sum_of_nothing_shared():
    assert lattice_sum(0.7, "none") == 0
    for pitch in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="pitch_f_lambda = .* found; a positive finite pitch is allowed"):
            lattice_sum(pitch, "intensity")
