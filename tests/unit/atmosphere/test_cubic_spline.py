"""Piecewise cubics against scipy's."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline as Scipys
from scipy.interpolate import PchipInterpolator

from surveysim.atmosphere.cubic_spline import CubicSpline, MonotoneCubic, stack_of


@pytest.mark.parametrize("n", [4, 5, 14, 801])
@pytest.mark.parametrize("seed", range(4))
def test_it_is_the_spline_of_scipy(n, seed):
    """Knots at random distances, so that rows are exchanged; within the knots, at them, and beyond both ends."""
    rng = np.random.default_rng(seed)
    x, y = np.cumsum(rng.exponential(size=n) + 1e-3), rng.normal(size=n).cumsum()
    ours, theirs = CubicSpline(x, y), Scipys(x, y)
    size = np.abs(theirs.c).max(axis=1, keepdims=True)
    np.testing.assert_allclose(ours.c / size, theirs.c / size, rtol=1e-12, atol=1e-13)
    q = np.concatenate([x, rng.uniform(x[0] - 1, x[-1] + 1, 300)]).reshape(-1, 1)
    for derivative in (0, 1):
        expected = theirs(q, derivative)
        np.testing.assert_allclose(ours(q, derivative), expected, rtol=1e-11, atol=1e-12 * np.abs(expected).max())


def test_it_passes_through_its_points_and_cubics():
    x = np.array([0.0, 0.3, 1.0, 1.2, 2.5])
    y = 1 - 2 * x + 0.5 * x**2 - 3 * x**3
    spline = CubicSpline(x, y)
    q = np.linspace(-1, 4, 50)
    np.testing.assert_allclose(spline(q), 1 - 2 * q + 0.5 * q**2 - 3 * q**3, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(spline(q, 1), -2 + q - 9 * q**2, rtol=1e-12, atol=1e-12)
    assert spline(0.3).shape == () and float(spline(0.3)) == pytest.approx(y[1])


@pytest.mark.parametrize("n", [2, 3, 4, 30])
@pytest.mark.parametrize("seed", range(4))
def test_the_monotone_cubic_is_that_of_scipy(n, seed):
    """Values that rise, fall and stay; within the knots, at them, and beyond both ends."""
    rng = np.random.default_rng(seed)
    x = np.cumsum(rng.exponential(size=n) + 1e-3)
    q = np.concatenate([x, rng.uniform(x[0] - 1, x[-1] + 1, 300)])
    for y in (rng.normal(size=n), rng.exponential(size=n).cumsum(), rng.integers(0, 3, n).astype(float)):
        expected = PchipInterpolator(x, y)(q)
        np.testing.assert_allclose(MonotoneCubic(x, y)(q), expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())


def test_members_of_a_stack_are_the_splines():
    rng = np.random.default_rng(5)
    knots, x, member = np.sort(rng.uniform(0, 1, 7)), rng.uniform(-0.1, 1.1, 9), np.array([2, 0, 1, 1, 0, 2, 2, 0, 1])
    splines = [CubicSpline(knots, values) for values in rng.standard_normal((3, 7))]
    for derivative in (0, 1):
        expected = [splines[k](at, derivative) for k, at in zip(member, x, strict=True)]
        np.testing.assert_array_equal(stack_of(splines)(x, derivative, member), expected)
