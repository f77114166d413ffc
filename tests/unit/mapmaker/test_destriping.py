"""Destriped maps against a brute-force fit of map and baselines together."""

import numpy as np
import pytest

from mapmaker.destriping import (
    BaselineWeight,
    DestripeOptions,
    baselines,
    destriped_map,
    measure_baseline_weight,
)
from mapmaker.geometry import MapGeometry
from mapmaker.iterative import StreamBlock
from mapmaker.normal_equations import SolveOptions
from mapmaker.timestreams import FocalPlane
from tests import naive

GEOMETRY = MapGeometry(2.3, 0.7, 1e-4, 6, 5)
BOUNDS = np.array([[0, 40], [45, 70], [75, 115]])
OPTIONS = DestripeOptions(9, SolveOptions(1e-12))


def block(rng, n_det=4):
    """Random pixels but the last, one sample in ten lost; white noise of each detector."""
    index = rng.integers(0, 29, (n_det, 115)).astype(np.int32)
    index[rng.random(index.shape) < 0.1] = -1
    data = rng.standard_normal(index.shape) * np.arange(1, n_det + 1)[:, None]
    return StreamBlock(data, index, BOUNDS, FocalPlane(np.arange(float(n_det)), np.zeros(n_det), 1e-4))


def test_baselines_are_pieces_of_scans():
    assert baselines(np.array([[0, 10], [12, 20], [20, 21]]), 4).tolist() == [
        [0, 5],
        [5, 10],
        [12, 16],
        [16, 20],
        [20, 21],
    ]


def test_weighing_is_the_dense_projection():
    rng = np.random.default_rng(1)
    item = block(rng)
    weight = BaselineWeight(np.array([1.0, 0.5, 2.0, 0.0]), 9)
    data = rng.standard_normal((2, *item.index.shape))
    found = weight.apply(data, item.index, BOUNDS)
    dense = naive.baseline_inverse(item.index, baselines(BOUNDS, 9), weight.weight)
    for start, stop in BOUNDS:
        expected = (data.reshape(2, -1) @ dense).reshape(data.shape)
        np.testing.assert_allclose(found[..., start:stop], expected[..., start:stop], atol=1e-12)


def test_map_is_the_fit_of_map_and_baselines():
    """Weighted least squares over pixels and baselines, with two observations of their own levels."""
    rng = np.random.default_rng(2)
    items = [block(rng), block(rng, 3)]
    result = destriped_map(GEOMETRY, lambda: iter(items), OPTIONS)
    rows, values = [], []
    edges = baselines(BOUNDS, 9)
    loose = [naive.baseline_matrix(item.index, edges) for item in items]
    for k, item in enumerate(items):
        level = measure_baseline_weight(item.data_mk, item.index, BOUNDS, 9).weight
        root = np.sqrt(np.where(item.index >= 0, level[:, None], 0.0)).ravel()
        inside = np.zeros(item.index.shape)
        for start, stop in BOUNDS:
            inside[:, start:stop] = 1
        root = root * inside.ravel()
        parts = [np.zeros((item.index.size, part.shape[1])) for part in loose]
        parts[k] = loose[k]
        rows.append(root[:, None] * np.concatenate([naive.pointing_matrix(item.index, 30), *parts], axis=1))
        values.append(root * item.data_mk.ravel())
    expected = np.linalg.lstsq(np.concatenate(rows), np.concatenate(values), rcond=1e-10)[0][:30]
    difference = result.map.signal_mk.ravel()[:29] - expected[:29]
    assert result.converged
    np.testing.assert_allclose(difference - difference.mean(), 0, atol=1e-9)


def test_a_sky_under_any_baselines_comes_back():
    """Off the map the streams have another sky, which does not matter."""
    rng = np.random.default_rng(3)
    item, sky = block(rng), rng.standard_normal(30)
    data = np.where(item.index >= 0, sky[item.index], 1e3)
    for first, end in baselines(BOUNDS, 9):
        data[:, first:end] += 100 * rng.standard_normal((4, 1))
    result = destriped_map(GEOMETRY, lambda: [StreamBlock(data, item.index, BOUNDS, item.focal_plane)], OPTIONS)
    difference = result.map.signal_mk.ravel()[:29] - sky[:29]
    np.testing.assert_allclose(difference - difference.mean(), 0, atol=1e-8)


def test_levels_are_measured_about_the_baselines():
    """20000 samples in baselines of 10 leave 18000 degrees of freedom: 5 sigma are 5 sqrt(2 / 18000)."""
    rng = np.random.default_rng(4)
    level = np.array([0.5, 1.0, 3.0])
    data = level[:, None] * rng.standard_normal((3, 20000)) + np.repeat(rng.standard_normal((3, 2000)), 10, axis=1)
    index = np.zeros(data.shape, np.int32)
    found = measure_baseline_weight(data, index, np.array([[0, 20000]]), 10).weight
    np.testing.assert_allclose(found * level**2, 1, rtol=5 * np.sqrt(2 / 18000))
    data[1], index[2] = 4.0, -1
    assert (measure_baseline_weight(data, index, np.array([[0, 20000]]), 10).weight[1:] == 0).all()


@pytest.mark.parametrize("length", [0, 1, 2.5])
def test_options_out_of_range(length):
    with pytest.raises(ValueError, match="baseline: found .* expected"):
        DestripeOptions(length)
