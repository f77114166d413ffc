"""Normal equations and their solution against dense algebra."""

import numpy as np
import pytest

from mapmaker.conjugate_gradients import block_descent
from mapmaker.destriping import BaselineWeight, baselines
from mapmaker.kernels.pixels import look_up
from mapmaker.map_scaling import scaling
from mapmaker.normal_equations import (
    NormalBlock,
    SolveOptions,
    add_diagonal,
    add_normal,
    add_right_side,
    normal_matrix,
    solve_normal,
)
from tests import naive

SHAPE = (5, 6)
N_PIXEL = 30
TIGHT = SolveOptions(1e-12)


def block(rng, n_det=4, length=7):
    """Three scans of 40 samples over random pixels, the last never seen, one sample in ten without data."""
    index = rng.integers(0, N_PIXEL - 1, (n_det, 130)).astype(np.int32)
    index[rng.random(index.shape) < 0.1] = -1
    return NormalBlock(
        index, np.array([[0, 40], [45, 85], [90, 130]]), BaselineWeight(np.arange(1.0, n_det + 1), length)
    )


def dense_normal(item):
    inside = np.full(item.index.shape, -1)
    for start, stop in item.scan_bounds:
        inside[:, start:stop] = item.index[:, start:stop]
    edges = baselines(item.scan_bounds, item.noise.length)
    pointing = naive.pointing_matrix(inside, N_PIXEL)
    return pointing, naive.baseline_inverse(inside, edges, item.noise.weight)


@pytest.fixture(scope="module")
def system():
    """Two blocks and their dense normal matrix."""
    rng = np.random.default_rng(1)
    items = [block(rng), block(rng, 3, 20)]
    pairs = [dense_normal(item) for item in items]
    return items, sum(p.T @ n @ p for p, n in pairs)


def test_a_sky_is_looked_up():
    rng = np.random.default_rng(2)
    index, skies = block(rng).index, rng.standard_normal((3, N_PIXEL))
    streams = np.empty((3, *index.shape))
    look_up(skies, index, streams)
    expected = naive.pointing_matrix(index, N_PIXEL) @ skies.T
    np.testing.assert_array_equal(streams.reshape(3, -1), expected.T)


def test_normal_matrix_and_right_side_are_the_dense_ones(system):
    items, dense = system
    rng = np.random.default_rng(3)
    skies = rng.standard_normal((3, N_PIXEL))
    np.testing.assert_allclose(normal_matrix(lambda: items, np.float64)(skies), skies @ dense, atol=1e-11)
    data = rng.standard_normal((2, *items[0].index.shape))
    out, one = np.ones((2, N_PIXEL)), np.zeros(N_PIXEL)
    add_right_side(items[0], data, out)
    pointing, inverse = dense_normal(items[0])
    np.testing.assert_allclose(out, 1 + data.reshape(2, -1) @ inverse @ pointing, atol=1e-11)
    add_right_side(items[0], data[1], one)
    np.testing.assert_allclose(one, out[1] - 1, atol=1e-12)


def test_single_precision_is_that_of_the_streams(system):
    items, dense = system
    skies, out = np.random.default_rng(4).standard_normal((2, N_PIXEL)), np.zeros((2, N_PIXEL))
    add_normal(items[0], skies.astype(np.float32), out)
    add_normal(items[1], skies.astype(np.float32), out)
    difference = np.abs(out - skies @ dense).max() / np.abs(out).max()
    assert 1e-9 < difference < 1e-6


def test_diagonal_has_hits_and_white_weights():
    """40 samples in 6 baselines of 7 or fewer: white noise keeps 34 of 40; detectors weigh 1 to 4."""
    item = block(np.random.default_rng(5))
    weight, hits = np.zeros(N_PIXEL), np.zeros(N_PIXEL, np.int64)
    add_diagonal(item, weight, hits)
    inside = np.concatenate([item.index[:, start:stop] for start, stop in item.scan_bounds], axis=1)
    np.testing.assert_array_equal(hits, np.bincount(inside[inside >= 0], minlength=N_PIXEL))
    by_detector = [np.bincount(row[row >= 0], minlength=N_PIXEL) for row in inside]
    np.testing.assert_allclose(weight, np.arange(1, 5) @ by_detector * 34 / 40, rtol=1e-12)


def test_solution_is_the_dense_one(system):
    """Right-hand sides may be 0 or depend on each other; a constant is undetermined."""
    items, dense = system
    truth = np.random.default_rng(6).standard_normal((3, N_PIXEL))
    truth[:, -1] = 0
    truth = np.concatenate([truth, truth[:1] - 2 * truth[1:2], np.zeros((1, N_PIXEL))])
    weight = np.diag(dense).reshape(SHAPE)
    found = solve_normal(normal_matrix(lambda: items, np.float64), truth @ dense, weight, options=TIGHT)
    difference = (found.sky_mk - truth)[:, :-1]
    np.testing.assert_allclose(difference - difference.mean(axis=1, keepdims=True), 0, atol=1e-9)
    assert found.converged.all() and found.residual.max() <= 1e-12 and not found.sky_mk[:, -1].any()
    again = solve_normal(normal_matrix(lambda: items, np.float64), truth @ dense, weight, options=TIGHT)
    np.testing.assert_array_equal(found.sky_mk, again.sky_mk)


def test_a_solution_that_has_not_converged_is_flagged(system):
    items, dense = system
    right = np.random.default_rng(7).standard_normal((2, N_PIXEL)) @ dense
    right[1] = 0
    apply, weight = normal_matrix(lambda: items, np.float64), np.diag(dense).reshape(SHAPE)
    found = solve_normal(apply, right, weight, options=SolveOptions(1e-12, 3))
    assert found.iterations == 3
    assert found.converged.tolist() == [False, True]
    root = scaling(apply, weight)
    rest = np.linalg.norm(root.back(right - apply(found.sky_mk)), axis=1)
    np.testing.assert_allclose(found.residual[0], rest[0] / np.linalg.norm(root.back(right)[0]), rtol=1e-9)


def test_rounding_ends_the_iterations(system):
    """Single precision does not reach 1e-12: the solver stops early and says so."""
    items, dense = system
    right = np.random.default_rng(8).standard_normal((1, N_PIXEL)) @ dense
    weight = np.diag(dense).reshape(SHAPE)
    found = solve_normal(normal_matrix(lambda: items, np.float32), right, weight, options=TIGHT)
    assert not found.converged[0] and found.residual[0] < 1e-5 and found.iterations < 300


def test_several_right_hand_sides_take_fewer_iterations():
    """Conjugate gradients take as many steps as there are distinct eigenvalues, over the number of right-hand sides."""
    rng = np.random.default_rng(9)
    turned = np.linalg.qr(rng.standard_normal((60, 60)))[0]
    matrix = turned * np.linspace(1, 40, 60) @ turned.T
    truth = rng.standard_normal((12, 60))
    target = np.full(12, 1e-9)
    one, steps = block_descent(lambda x: x @ matrix, truth[:1] @ matrix, target=target[:1], max_iterations=200)
    assert 40 < steps <= 75
    np.testing.assert_allclose(one, truth[:1], atol=1e-8)
    found, steps = block_descent(lambda x: x @ matrix, truth @ matrix, target=target, max_iterations=200)
    assert steps <= 6
    np.testing.assert_allclose(found, truth, atol=1e-8)


def test_dependent_right_hand_sides_cost_nothing():
    rng = np.random.default_rng(10)
    matrix = np.diag(np.linspace(1, 9, 20))
    asked = []

    def apply(vectors):
        asked.append(len(vectors))
        return vectors @ matrix

    right = np.outer([1.0, -2.0, 0.5], rng.standard_normal(20))
    found, _ = block_descent(apply, right, target=np.full(3, 1e-9), max_iterations=50)
    assert set(asked) == {1}
    np.testing.assert_allclose(found @ matrix, right, atol=1e-8)


def test_scaling_is_symmetric_and_finds_the_spectrum():
    """Of a convolution with weights: 4 probes and their neighbours know a mode to a fifth, 5 sigma."""
    rng = np.random.default_rng(11)
    shape = (48, 64)
    weight = rng.uniform(1, 3, shape)
    ell = np.hypot(np.fft.fftfreq(48)[:, None], np.fft.rfftfreq(64))
    share = 0.1 + 0.9 * np.minimum(1, 4 * ell)

    def apply(skies):
        plane = np.fft.irfft2(np.fft.rfft2(skies.reshape(-1, *shape) * np.sqrt(weight)) * share, shape)
        return (plane * np.sqrt(weight)).reshape(skies.shape)

    root = scaling(apply, weight)
    x, y = rng.standard_normal((2, 1, weight.size))
    np.testing.assert_allclose(np.sum(root(x) * y), np.sum(x * root.back(y)), rtol=1e-10)
    inside = ell > 0.05  # at the peak the smoothing shows
    np.testing.assert_allclose(root.modes[inside] ** -2 / share[inside], 1, atol=0.6)
    assert np.mean(root.modes[inside] ** -2 / share[inside]) == pytest.approx(1, abs=0.02)
