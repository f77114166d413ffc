"""Look-ups along curved tracks against their slow twins, and against those of straight tracks."""

import numpy as np
import pytest

from surveysim.atmosphere import curved_kernels as kernels
from surveysim.atmosphere import screen_kernels
from tests import naive

LOOK_UPS = ["", "_nearest", "_cubic"]
N_DET, N_LANE, N_X, N = 7, 30, 90, 600


def tracks(seed=1, dtype=np.float32):
    """A strip, and a boresight that winds over it with turning offsets of up to 5 steps."""
    rng = np.random.default_rng(seed)
    strip = rng.standard_normal((N_LANE, N_X)).astype(dtype)
    phase = np.linspace(0, 7, N)
    x, y = 45 + 38 * np.sin(phase), 14.5 + 8 * np.cos(3 * phase)
    turn, offset = 0.3 * phase, 5 * rng.random(N_DET) * np.exp(2j * np.pi * rng.random(N_DET))
    return strip, x, y, np.cos(turn), np.sin(turn), 1 + 0.1 * np.sin(phase), offset.real, offset.imag


@pytest.mark.parametrize("kind", LOOK_UPS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_curved_look_ups_equal_their_twins(kind, dtype):
    item = tracks(dtype=dtype)
    data = np.random.default_rng(5).standard_normal((N_DET, N + 40)).astype(dtype)
    expected = data.astype(float)
    naive.add_curved(getattr(naive, f"add_screen{kind}"), expected, 20, N + 20, *item)
    getattr(kernels, f"add_curved{kind}")(data, 20, N + 20, *item)
    np.testing.assert_allclose(data, expected, rtol=0, atol=1e-5 if dtype == np.float32 else 1e-12)


@pytest.mark.parametrize("kind", LOOK_UPS)
def test_straight_tracks_through_the_curved_kernel(kind):
    strip, *_, u, v = tracks(dtype=np.float64)
    found, expected = np.zeros((2, N_DET, N))
    speed, n = 0.11, np.arange(N)
    still = np.ones(N), np.zeros(N), np.full(N, 1.3)
    getattr(kernels, f"add_curved{kind}")(found, 0, N, strip, 6 + speed * n, np.full(N, 14.5), *still, u, v)
    getattr(screen_kernels, f"add_screen{kind}")(expected, 0, N, strip, 6 + u, 14.5 - v, speed, 1.3)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


def test_a_strip_s_last_point_is_inside():
    strip, n = np.arange(12.0).reshape(3, 4), np.arange(4.0)
    for kind in ("", "_nearest"):
        data = np.zeros((1, 4))
        still = np.ones(4), np.zeros(4), np.ones(4), np.zeros(1), np.zeros(1)
        getattr(kernels, f"add_curved{kind}")(data, 0, 4, strip, n, np.full(4, 2.0), *still)
        np.testing.assert_array_equal(data[0], strip[2])


@pytest.mark.parametrize("kind", LOOK_UPS)
@pytest.mark.parametrize(
    "number, value", [(1, 84.9), (1, 4.9), (1, np.nan), (2, 4.9), (2, 24.3), (3, np.nan), (3, 9.0)]
)
def test_tracks_that_leave_the_strip_are_refused(kind, number, value):
    item = [part.copy() for part in tracks()]
    item[6][:], item[7][:] = 3, -4
    item[number][300] = value
    with pytest.raises(ValueError, match="leaves the strip"):
        getattr(kernels, f"add_curved{kind}")(np.zeros((N_DET, N)), 0, N, *item)


def test_offsets_that_are_not_numbers_are_refused():
    item = tracks()
    item[6][2] = np.nan
    with pytest.raises(ValueError, match="leaves the strip"):
        kernels.add_curved(np.zeros((N_DET, N)), 0, N, *item)


@pytest.mark.parametrize("start, n_det, n", [(-1, N_DET, N), (1, N_DET, N), (0, N_DET - 1, N), (0, N_DET, N - 1)])
def test_samples_outside_the_data_are_refused(start, n_det, n):
    strip, x, *rest = tracks()
    with pytest.raises(IndexError, match="outside the data"):
        kernels.add_curved(np.zeros((n_det, N)), start, start + N, strip, x[:n], *rest)


def test_cubic_look_up_needs_four_lanes():
    strip, x, _, *rest = tracks()
    with pytest.raises(IndexError, match="four lanes"):
        kernels.add_curved_cubic(
            np.zeros((N_DET, N)), 0, N, strip[:3], x, np.ones(N), *rest[:-2], *np.zeros((2, N_DET))
        )
