"""Kernels of the atmospheric screen against their slow twins."""

import numpy as np
import pytest

from surveysim.atmosphere import screen_kernels as kernels
from tests import naive


def tracks(seed, n_det, n_lane, n_x, span):
    rng = np.random.default_rng(seed)
    strip = rng.standard_normal((n_lane, n_x)).astype(np.float32)
    return strip, rng.random(n_det) * (n_x - 1 - span), rng.random(n_det) * (n_lane - 1)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("dx", [0.0, 0.37, 1.0, 2.9])
def test_add_screen_is_bilinear(dtype, dx):
    strip, x0, y0 = tracks(1, 7, 5, 200, 59 * dx)
    data = np.random.default_rng(2).standard_normal((7, 100)).astype(dtype)
    expected = data.astype(np.float64)
    naive.add_screen(expected, 20, 80, strip, x0, y0, dx, 1.7)
    kernels.add_screen(data, 20, 80, strip, x0, y0, dx, 1.7)
    np.testing.assert_allclose(data, expected, atol=3e-6)


def test_add_weighted():
    rng = np.random.default_rng(4)
    data, values, weight = (
        rng.random((3, 40)).astype(np.float32),
        rng.random((3, 20)).astype(np.float32),
        rng.random(20),
    )
    expected = data.astype(float)
    naive.add_weighted(expected, 13, values, weight)
    kernels.add_weighted(data, 13, values, weight)
    np.testing.assert_allclose(data, expected, rtol=1e-6)


@pytest.mark.parametrize(("start", "n_det", "n"), [(-1, 3, 20), (21, 3, 20), (0, 2, 20), (0, 3, 19)])
def test_add_weighted_refuses_samples_outside(start, n_det, n):
    with pytest.raises(IndexError):
        kernels.add_weighted(np.zeros((3, 40)), start, np.zeros((n_det, 20)), np.zeros(n))


def test_add_screen_at_the_edges():
    strip = np.arange(12, dtype=np.float32).reshape(3, 4)
    data = np.zeros((4, 4))
    kernels.add_screen(data, 0, 4, strip, np.zeros(4), np.array([0.0, 1.0, 1.5, 2.0]), 1.0, 1.0)
    np.testing.assert_array_equal(data, [strip[0], strip[1], 0.5 * (strip[1] + strip[2]), strip[2]])


@pytest.mark.parametrize(
    ("x0", "y0", "dx"),
    [(-0.1, 1.0, 0.1), (190.0, 1.0, 1.0), (0.0, -0.1, 0.1), (0.0, 4.1, 0.1), (5.0, 1.0, -0.1)]
    + [(np.nan, 1.0, 0.1), (1.0, np.nan, 0.1), (1.0, 1.0, np.nan)],
)
def test_add_screen_refuses_tracks_outside(x0, y0, dx):
    with pytest.raises(ValueError, match="leaves the strip"):
        kernels.add_screen(
            np.zeros((1, 50)), 0, 50, np.zeros((5, 200), np.float32), np.array([x0]), np.array([y0]), dx, 1.0
        )


@pytest.mark.parametrize(("start", "stop", "n"), [(-1, 5, 2), (0, 51, 2), (5, 5, 2), (0, 50, 1), (0, 50, 3)])
def test_add_screen_refuses_samples_outside(start, stop, n):
    with pytest.raises(IndexError, match="outside the data"):
        kernels.add_screen(
            np.zeros((2, 50)), start, stop, np.zeros((5, 200), np.float32), np.zeros(n), np.zeros(n), 0.1, 1.0
        )


@pytest.mark.parametrize("kind", ["nearest", "cubic"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("dx", [0.0, 0.37, 1.0, 2.9])
def test_other_look_ups_equal_their_twins(kind, dtype, dx):
    strip, x0, y0 = tracks(4, 7, 5, 200, 59 * dx)
    strip = strip.astype(dtype)
    data = np.random.default_rng(5).standard_normal((7, 100)).astype(dtype)
    expected = data.astype(np.float64)
    getattr(naive, f"add_screen_{kind}")(expected, 20, 80, strip, x0, y0, dx, 1.7)
    getattr(kernels, f"add_screen_{kind}")(data, 20, 80, strip, x0, y0, dx, 1.7)
    np.testing.assert_allclose(data, expected, atol=5e-6 if dtype == np.float32 else 1e-12)


@pytest.mark.parametrize("shape", [(4, 4), (4, 30), (9, 30)])
def test_cubic_look_up_reproduces_cubics_up_to_the_edges(shape):
    def field(x, y):
        return 1 - 0.3 * x + 0.02 * x**3 + y * (0.5 - 0.1 * x**2) - 0.04 * y**3 * x

    strip = field(np.arange(shape[1])[None, :], np.arange(shape[0])[:, None])
    y0 = np.linspace(0, shape[0] - 1, 7)
    data = np.zeros((7, 31))
    dx = (shape[1] - 1) / 30
    kernels.add_screen_cubic(data, 0, 31, strip, np.zeros(7), y0, dx, 2.0)
    expected = 2 * field(dx * np.arange(31)[None, :], y0[:, None])
    np.testing.assert_allclose(data, expected, rtol=0, atol=1e-12 * np.abs(strip).max())


def test_bilinear_look_up_does_not_reproduce_cubics():
    strip = np.broadcast_to(np.arange(30.0) ** 3, (4, 30))
    data = np.zeros((1, 1))
    kernels.add_screen(data, 0, 1, strip, np.array([2.5]), np.array([1.5]), 0.0, 1.0)
    assert data[0, 0] == 0.5 * (2**3 + 3**3) != 2.5**3


@pytest.mark.parametrize("kind", ["nearest", "cubic"])
def test_other_look_ups_at_the_lattice_points(kind):
    strip = np.random.default_rng(6).standard_normal((5, 6))
    data = np.zeros((5, 6))
    getattr(kernels, f"add_screen_{kind}")(data, 0, 6, strip, np.zeros(5), np.arange(5.0), 1.0, 1.0)
    np.testing.assert_allclose(data, strip, atol=1e-15)


@pytest.mark.parametrize("kind", ["nearest", "cubic"])
def test_other_look_ups_refuse_what_is_outside(kind):
    add, strip = getattr(kernels, f"add_screen_{kind}"), np.zeros((5, 200), np.float32)
    with pytest.raises(ValueError, match="leaves the strip"):
        add(np.zeros((1, 50)), 0, 50, strip, np.array([190.0]), np.array([1.0]), 1.0, 1.0)
    with pytest.raises(IndexError, match="outside the data"):
        add(np.zeros((2, 50)), 0, 51, strip, np.zeros(2), np.zeros(2), 0.1, 1.0)


def test_cubic_look_up_needs_four_lanes():
    with pytest.raises(IndexError, match="four lanes"):
        kernels.add_screen_cubic(np.zeros((1, 5)), 0, 5, np.zeros((3, 9)), np.zeros(1), np.zeros(1), 0.1, 1.0)


def test_combine_columns_is_a_sum_over_factors():
    rng = np.random.default_rng(3)
    start = np.array([0, 3, 3, 4, 7])
    columns = np.zeros((7, 8), np.float32)
    columns[:, :5] = rng.standard_normal((7, 5))
    normals = rng.standard_normal((2, 15)).astype(np.float32)
    modes = np.empty((2, 5, 4), np.complex64)
    kernels.combine_columns(columns, start, normals, modes)
    for own, found in zip(normals, modes, strict=True):
        np.testing.assert_allclose(found, naive.combine_columns(columns[:, :5], start, own), atol=1e-5)
