"""Overlap of pixels against quadrature over the stop, and sums over lattices against Poisson's formula."""

import numpy as np
import pytest

from surveysim.coherence import correlation_factor, correlation_matrix, mutual_coherence
from surveysim.instrument import hexagon

DENSE = pytest.mark.parametrize("pitch", [0.1, 0.7, 1.3])
COHERENCES = pytest.mark.parametrize("coherence", ["field", "intensity", "none"])


def test_values_of_the_paper():
    assert mutual_coherence(0.0) == 1
    assert mutual_coherence(0.7) == pytest.approx(0.506, abs=5e-4)  # section 5.1: 50 % for neighbours
    # First zeros of J1 at 3.8317 and 7.0156, over pi: Airy's 1.22 and 2.23.
    assert mutual_coherence(np.array([3.8317059702, 7.0155866698]) / np.pi) == pytest.approx([0, 0], abs=1e-9)
    assert mutual_coherence(1.21) > 0 > mutual_coherence(1.23)


def test_small_separations_are_smooth():
    """gamma = 1 - (pi s)^2 / 8 + ..., without trouble at or near 0; even in s."""
    s = np.array([1e-12, 1e-6, 1e-3])
    np.testing.assert_allclose(mutual_coherence(s), 1 - (np.pi * s) ** 2 / 8, rtol=1e-12)
    np.testing.assert_array_equal(mutual_coherence(-s), mutual_coherence(s))


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
    assert mutual_coherence(s) == pytest.approx(stop_quadrature(s), abs=1e-13)


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


@DENSE
@COHERENCES
def test_positive_semi_definite(pitch, coherence):
    """61 pixels, at 0.1 (f/#)lambda with a few modes between them; rounding is eps times the norm."""
    values = np.linalg.eigvalsh(correlation_matrix(hexagon(4, pitch), coherence))
    assert values[0] > -1e-14 * len(values) * values[-1]
    if pitch == 0.1 and coherence == "field":
        # Area of the array times that of the stop, 61 * 0.0087 * pi / 4 = 0.41 modes, and those of its edge.
        assert values[-1] > 0.5 * values.sum() and (values > 1e-3).sum() < 15


@DENSE
@COHERENCES
def test_factor(pitch, coherence):
    matrix = correlation_matrix(hexagon(4, pitch), coherence)
    factor = correlation_factor(matrix)
    assert factor.shape == matrix.shape
    # Eigenvectors are orthogonal to some eps n, and what is clipped of these matrices is rounding.
    np.testing.assert_allclose(factor @ factor.T, matrix, atol=1e-12)


def test_a_matrix_that_is_no_correlation_is_refused():
    with pytest.raises(ValueError, match="has the eigenvalue -0.2.*none below 0 is allowed"):
        correlation_factor(np.array([[1, 1.2], [1.2, 1]]))
    with pytest.raises(ValueError, match="eigenvalue"):
        correlation_factor(np.array([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]]))


def lattice_sum(pitch, rings):
    """Sum of gamma^2 from one pixel of a hexagonal lattice over all others up to `rings` pitches away."""
    q, r = np.meshgrid(np.arange(-2 * rings, 2 * rings + 1), np.arange(-2 * rings, 2 * rings + 1))
    distance = np.hypot(q + 0.5 * r, np.sqrt(0.75) * r)
    distance = distance[(distance > 0) & (distance <= rings)] * pitch
    return np.sum(mutual_coherence(distance) ** 2)


def poisson_sum(pitch):
    """The same over the whole lattice: overlap of two stops (the MTF) at the points of the reciprocal one."""
    cell = np.sqrt(0.75) * pitch**2
    q, r = np.meshgrid(np.arange(-3, 4), np.arange(-3, 4))
    k = np.hypot(q + 0.5 * r, np.sqrt(0.75) * r) / (np.sqrt(0.75) * pitch)
    inside = np.clip(k, 0, 1)
    overlap = 2 / np.pi * (np.arccos(inside) - inside * np.sqrt(1 - inside**2))
    return np.sum(overlap) * (4 / np.pi) / cell - 1


@pytest.mark.parametrize("pitch, expected", [(0.7, 2.00), (1.0, 0.47), (1.2, 0.07)])
def test_shared_power_of_a_lattice(pitch, expected):
    """Noise that a whole lattice shares: 2.00, 0.47, 0.07 at 0.7, 1.0, 1.2 (f/#)lambda."""
    rings = 300
    # On average J1(x)^2 = 1 / (pi x), so that the pixels beyond hold 8 / (pi^3 R cell) all in all.
    beyond = 8 / (np.pi**3 * rings * pitch * np.sqrt(0.75) * pitch**2)
    assert beyond < 0.003
    total = lattice_sum(pitch, rings) + beyond
    assert total == pytest.approx(poisson_sum(pitch), abs=0.1 * beyond)
    assert total == pytest.approx(expected, abs=0.005)
