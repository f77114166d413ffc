"""Kernels of the atmospheric screen against their slow twins."""

import numpy as np
import pytest

from surveysim.kernels import screen as kernels
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


def test_combine_columns_is_a_sum_over_factors():
    rng = np.random.default_rng(3)
    start = np.array([0, 3, 3, 4, 7])
    columns = rng.standard_normal((7, 5)).astype(np.float32)
    normals = rng.standard_normal(15).astype(np.float32)
    modes = np.empty((5, 4), np.complex64)
    kernels.combine_columns(columns, start, normals, modes)
    np.testing.assert_allclose(modes, naive.combine_columns(columns, start, normals), atol=1e-5)
