"""Maximum-likelihood maps against dense algebra on problems small enough for it."""

import numpy as np
import pytest

from mapmaker.destriping import BaselineWeight
from mapmaker.geometry import MapGeometry
from mapmaker.gls import GlsOptions, NoiseModel, band_slices, gls_map, measure_noise, measure_scan_noise
from mapmaker.iterative import StreamBlock
from mapmaker.normal_equations import (
    NormalBlock,
    SolveOptions,
    add_diagonal,
    add_right_side,
    normal_matrix,
    solve_normal,
)
from mapmaker.timestreams import FocalPlane
from tests import naive

RATE = 10.0
EDGES = (0.0, 1.0, 2.5, np.inf)
GEOMETRY = MapGeometry(2.3, 0.7, 1e-4, 4, 3)
TIGHT = GlsOptions(band_edges_hz=EDGES, max_modes=2, folds=2, solve=SolveOptions(1e-12))


def plane(n_det):
    return FocalPlane(np.arange(float(n_det)), np.zeros(n_det), 1e-4)


def model(rng, n_det=5, n_mode=2):
    """White levels around 1 and strong modes in three bands."""
    white = rng.uniform(0.5, 2, (3, n_det))
    return NoiseModel(EDGES, white, tuple(3 * rng.standard_normal((n_det, n_mode)) for _ in range(3)), RATE)


def covariances(noise):
    return [np.diag(w) + v @ v.T for w, v in zip(noise.white_mk2, noise.modes_mk, strict=True)]


def dense_inverse(noise, n):
    bands = np.full(n, -1)
    for b, band in enumerate(band_slices(n, RATE, noise.band_edges_hz)):
        bands[band] = b
    return naive.inverse_covariance(bands, covariances(noise))


def small_block(rng, n_det=6, lengths=(12, 9, 12, 12)):
    """Streams over a few pixels of a 4 x 3 map, one sample in ten off it and one pixel never seen."""
    stop = np.cumsum(np.array(lengths) + 2) - 2
    bounds = np.column_stack([stop - lengths, stop])
    index = rng.integers(0, 11, (n_det, stop[-1])).astype(np.int32)
    index[rng.random(index.shape) < 0.1] = -1
    common = rng.standard_normal(stop[-1]).cumsum()
    data = rng.standard_normal((n_det, stop[-1])) + 2 * common
    return StreamBlock(data, index, bounds, plane(n_det))


def mapped(block, options=TIGHT, **known):
    return gls_map(GEOMETRY, lambda: [block], sample_rate_hz=RATE, options=options, **known)


def applied(noise, scan):
    return noise.apply(scan[None], np.zeros(scan.shape, np.int32), np.array([[0, scan.shape[1]]]))[0]


def test_bands_hold_every_mode_but_the_mean():
    """12 samples at 10 Hz: modes are 10 / 24 Hz apart; 2.5 Hz is mode 6, which begins a band."""
    assert band_slices(12, RATE, EDGES) == [slice(1, 3), slice(3, 6), slice(6, 12)]
    assert band_slices(12, RATE, (0.6, 2.5)) == [slice(2, 6)]


@pytest.mark.parametrize("n_mode", [0, 2])
def test_weighing_is_the_inverse_covariance(n_mode):
    rng = np.random.default_rng(1)
    noise = model(rng, n_mode=n_mode)
    scan = rng.standard_normal((5, 12))
    expected = (dense_inverse(noise, 12) @ scan.ravel()).reshape(5, 12)
    np.testing.assert_allclose(applied(noise, scan), expected, rtol=1e-10, atol=1e-12)


def test_the_mean_of_a_scan_has_no_information():
    rng = np.random.default_rng(2)
    noise, scan = model(rng), rng.standard_normal((5, 12))
    np.testing.assert_allclose(applied(noise, scan + np.arange(5)[:, None]), applied(noise, scan), atol=1e-12)
    np.testing.assert_allclose(applied(noise, scan).sum(axis=1), 0, atol=1e-12)


def test_map_is_the_dense_solution():
    """Two observations, scans of two lengths, samples off the map and a pixel without a hit."""
    rng = np.random.default_rng(3)
    blocks = [small_block(rng), small_block(rng)]
    result = gls_map(GEOMETRY, lambda: iter(blocks), sample_rate_hz=RATE, options=TIGHT)
    scans = []
    for block in blocks:
        for s, (start, stop) in enumerate(block.scan_bounds):
            # Every other scan is in the other part.
            noise = measure_noise(block.data_mk, block.scan_bounds[1 - s % 2 :: 2], block.focal_plane, RATE, TIGHT)
            data, index = block.data_mk[:, start:stop], block.index[:, start:stop]
            scans.append((data, index, dense_inverse(noise, stop - start)))
    expected = naive.gls_map(scans, 12)
    assert result.converged and result.residual < 1e-11
    np.testing.assert_allclose(result.map.signal_mk.ravel(), expected, atol=1e-9)
    assert result.map.hits.ravel()[11] == result.map.weight.ravel()[11] == result.map.signal_mk.ravel()[11] == 0


def test_even_white_noise_gives_the_binned_map():
    """Each scan sees each pixel as often: taking its mean out is taking the map's mean out, and no more."""
    rng = np.random.default_rng(4)
    index = np.array([rng.permutation(12) for _ in range(5 * 4)]).reshape(5, 48).astype(np.int32)
    bounds = np.arange(5)[:4, None] * 12 + [0, 12]
    data = rng.standard_normal((5, 48))
    options = GlsOptions(band_edges_hz=(0.0, np.inf), max_modes=0, solve=SolveOptions(1e-12))
    scans = data.reshape(5, 4, 12)
    # Equal measured levels of all detectors and scans.
    data /= np.repeat(np.std(scans, axis=2), 12, axis=1)
    result = gls_map(
        GEOMETRY, lambda: [StreamBlock(data, index, bounds, plane(5))], sample_rate_hz=RATE, options=options
    )
    binned = np.bincount(index.ravel(), data.ravel()) / 20
    np.testing.assert_allclose(result.map.signal_mk.ravel(), binned - binned.mean(), atol=1e-10)
    np.testing.assert_array_equal(result.map.hits, 20)


def test_weight_is_that_of_the_white_noise():
    """20 samples a pixel of level w, less the share of the mean, 1 / 12."""
    index = np.tile(np.arange(12, dtype=np.int32), (5, 4))
    data = np.random.default_rng(5).standard_normal((5, 48))
    options = GlsOptions(band_edges_hz=(0.0, np.inf), max_modes=0, folds=2)
    block = StreamBlock(data, index, np.arange(4)[:, None] * 12 + [0, 12], plane(5))
    found = measure_scan_noise(data, block.scan_bounds, block.focal_plane, RATE, options)
    levels = [model.white_mk2[0] for model in found.models]
    result = mapped(block, options)
    np.testing.assert_allclose(result.map.weight, 2 * np.sum(1 / np.array(levels)) * 11 / 12, rtol=1e-12)


def test_a_sky_known_beforehand_does_not_disturb_the_noise():
    """With the true sky out of the measurement the map is that of the noise, plus the sky."""
    rng = np.random.default_rng(6)
    index = np.array([rng.permutation(12) for _ in range(5 * 8)]).reshape(5, 96).astype(np.int32)
    noise = rng.standard_normal((5, 96))
    sky = rng.standard_normal((1, 3, 4))
    bounds = np.arange(8)[:, None] * 12 + [0, 12]
    alone = StreamBlock(noise, index, bounds, plane(5))
    both = StreamBlock(noise + sky.ravel()[index], index, bounds, plane(5))
    expected = mapped(alone).map.signal_mk + sky - sky.mean()
    np.testing.assert_allclose(mapped(both, sky_mk=sky).map.signal_mk, expected, atol=1e-9)
    assert np.abs(mapped(both).map.signal_mk - expected).max() > 1e-3


def test_scans_that_are_not_finite_are_left_out():
    rng = np.random.default_rng(7)
    block = small_block(rng)
    rest = StreamBlock(block.data_mk.copy(), block.index, block.scan_bounds[1:], block.focal_plane)
    block.data_mk[2, 3] = np.nan
    result, expected = (mapped(b) for b in (block, rest))
    assert (result.discarded, expected.discarded) == (1, 0)
    np.testing.assert_array_equal(result.map.signal_mk, expected.map.signal_mk)
    block.data_mk[:] = np.inf
    with pytest.raises(ValueError, match="found no observation with finite"):
        mapped(block)


def test_a_dead_detector_is_left_out():
    rng = np.random.default_rng(8)
    block = small_block(rng, n_det=7)
    block.data_mk[3] = 5.0
    live = np.arange(7) != 3
    rest = StreamBlock(block.data_mk[live], block.index[live], block.scan_bounds, plane(6))
    result, expected = (mapped(b) for b in (block, rest))
    np.testing.assert_allclose(result.map.signal_mk, expected.map.signal_mk, atol=1e-10)
    block.data_mk[:] = 5.0
    with pytest.raises(ValueError, match="found no detector with noise"):
        mapped(block)


def test_iterations_are_bounded():
    block = small_block(np.random.default_rng(9))
    result = gls_map(
        GEOMETRY,
        lambda: [block],
        sample_rate_hz=RATE,
        options=GlsOptions(band_edges_hz=EDGES, solve=SolveOptions(1e-12, 2)),
    )
    assert result.iterations == 2 and not result.converged
    assert result.residual > 1e-12


def test_modes_and_levels_are_measured():
    """One mode in the lowest band only, over levels known per detector.

    n deviates give a variance to sqrt(2 / n); the lowest band has 1200 modes, the detectors' levels 14900.
    """
    rng = np.random.default_rng(10)
    n_det, n, n_scan = 8, 150, 100
    level = np.linspace(0.5, 2, n_det)
    pattern = np.linspace(1, 2, n_det)
    modes = rng.standard_normal((n_scan, n_det, n)) * np.sqrt(level)[:, None]
    low = slice(1, 13)
    modes[:, :, low] += 5 * pattern[:, None] * rng.standard_normal((n_scan, 1, 12))
    rows = naive.cosine_modes(n)
    data = np.concatenate(list(modes @ rows), axis=1)
    bounds = np.arange(n_scan)[:, None] * n + [0, n]
    # Mode k is at k / 30 Hz.
    noise = measure_noise(data, bounds, plane(len(data)), RATE, GlsOptions(band_edges_hz=(0, 12.5 / 30, 2, np.inf)))
    assert [item.shape[1] for item in noise.modes_mk] == [1, 0, 0]
    covariance = noise.modes_mk[0] @ noise.modes_mk[0].T
    tolerance = 5 * np.sqrt(2 / 1200)
    np.testing.assert_allclose(covariance, 25 * np.outer(pattern, pattern), rtol=tolerance)
    for band in (1, 2):
        np.testing.assert_allclose(noise.white_mk2[band], level, rtol=5 * np.sqrt(2 / 3000))


def test_noise_without_correlations_has_no_modes():
    rng = np.random.default_rng(11)
    data = rng.standard_normal((30, 1500)) * np.linspace(0.5, 2, 30)[:, None]
    noise = measure_noise(
        data, np.arange(10)[:, None] * 150 + [0, 150], plane(30), RATE, GlsOptions(eigenvalue_cut=1.2)
    )
    assert [item.shape[1] for item in noise.modes_mk] == [0] * 6


def test_modes_are_bounded():
    """Three orthogonal patterns, far above the rest."""
    rng = np.random.default_rng(12)
    signs = np.array([[1, 1, 1, 1, 1, 1, 1, 1], [1, -1, 1, -1, 1, -1, 1, -1], [1, 1, -1, -1, 1, 1, -1, -1]])
    streams = 10 * signs.T @ rng.standard_normal((3, 240)) + rng.standard_normal((8, 240))
    bounds = np.arange(4)[:, None] * 60 + [0, 60]
    options = [GlsOptions((0.0, np.inf), n) for n in (0, 2, 20)]
    found = [measure_noise(streams, bounds, plane(len(streams)), RATE, item) for item in options]
    # A line of eight detectors has two smooth shapes, which no pattern but the first is.
    assert [noise.modes_mk[0].shape[1] for noise in found] == [0, 2, 5]


def test_a_band_without_modes():
    block = small_block(np.random.default_rng(15))
    with pytest.raises(ValueError, match=r"the scans have 0 modes from 0.0 to 0.01 Hz; 2 or more"):
        measure_noise(block.data_mk, block.scan_bounds, block.focal_plane, RATE, GlsOptions((0.0, 0.01, np.inf)))


@pytest.mark.parametrize(
    "values",
    [
        {"band_edges_hz": (1.0,)},
        {"band_edges_hz": (1.0, 1.0)},
        {"band_edges_hz": (-1.0, 1.0)},
        {"max_modes": -1},
        {"eigenvalue_cut": 0.9},
        {"folds": 1},
    ],
)
def test_options_out_of_range(values):
    with pytest.raises(ValueError, match=f"{next(iter(values))}: found .* expected"):
        GlsOptions(**values)


def linear_map(item):
    """Map (12, n_det n_samp) of every sample alone, less its mean over the map."""
    return solved(item, np.eye(item.index.size).reshape(-1, *item.index.shape)).T


def solved(item, streams):
    """Maps (n, 12) of streams (n, n_det, n_samp), less their means."""
    streams = streams.reshape(-1, *item.index.shape)
    right, weight, hits = np.zeros((len(streams), 12)), np.zeros(12), np.zeros(12, np.int64)
    add_right_side(item, streams, right)
    add_diagonal(item, weight, hits)
    found = solve_normal(
        normal_matrix(lambda: [item], np.float64), right, weight.reshape(3, 4), options=SolveOptions(1e-12)
    )
    assert found.converged.all()
    return found.sky_mk - found.sky_mk.mean(axis=1, keepdims=True)


def test_no_unbiased_linear_map_has_less_noise():
    """Covariance (P^T N^-1 P)^-1 with the true N (Gauss and Markov); other makers exceed it in every direction."""
    rng = np.random.default_rng(13)
    index = rng.integers(0, 12, (5, 48)).astype(np.int32)
    bounds = np.arange(4)[:, None] * 12 + [0, 12]
    noise = model(rng)
    inverse, covariance = np.zeros((5, 48, 5, 48)), np.zeros((5, 48, 5, 48))
    for start, stop in bounds:
        one = dense_inverse(noise, 12)
        inverse[:, start:stop, :, start:stop] = one.reshape(5, 12, 5, 12)
        # The means of scans have no weight in any of these maps: any variance of theirs does.
        covariance[:, start:stop, :, start:stop] = np.linalg.pinv(one, rcond=1e-10, hermitian=True).reshape(
            5, 12, 5, 12
        )
    inverse, covariance = inverse.reshape(240, 240), covariance.reshape(240, 240)
    pointing = naive.pointing_matrix(index, 12)
    flat = np.eye(12) - 1 / 12
    best = linear_map(NormalBlock(index, bounds, noise))
    least = best @ covariance @ best.T
    expected = flat @ np.linalg.pinv(pointing.T @ inverse @ pointing, rcond=1e-10, hermitian=True) @ flat
    np.testing.assert_allclose(least, expected, atol=1e-9)
    np.testing.assert_allclose(best @ pointing, flat, atol=1e-9)
    for other in (BaselineWeight(np.ones(5), 6), BaselineWeight(np.ones(5), 12), model(rng)):
        maker = linear_map(NormalBlock(index, bounds, other))
        np.testing.assert_allclose(maker @ pointing, flat, atol=1e-9)
        excess = np.linalg.eigvalsh(maker @ covariance @ maker.T - least)
        assert excess[0] > -1e-9 and excess[-1] > 0.1


def test_a_sky_without_noise_comes_back():
    """Whatever the noise model, if no sample is off the map."""
    rng = np.random.default_rng(14)
    index = rng.integers(0, 12, (6, 60)).astype(np.int32)
    sky = rng.standard_normal(12)
    bounds = np.arange(4)[:, None] * 15 + [0, 15]
    found = mapped(StreamBlock(sky[index], index, bounds, plane(6))).map.signal_mk.ravel()
    np.testing.assert_allclose(found - found.mean(), sky - sky.mean(), atol=1e-8)


def test_the_noise_of_a_scan_is_measured_in_others():
    """Of three parts; the streams of a scan do not change its own model, and a single scan has its own."""
    rng = np.random.default_rng(16)
    data, bounds = rng.standard_normal((6, 210)), np.arange(7)[:, None] * 30 + [0, 30]
    options = GlsOptions(EDGES, folds=3)
    before = measure_scan_noise(data, bounds, plane(len(data)), RATE, options).models
    expected = measure_noise(data, bounds[[0, 2, 3, 5, 6]], plane(len(data)), RATE, options)
    np.testing.assert_array_equal(before[1].white_mk2, expected.white_mk2)
    changed = data.copy()
    changed[:, 30:60] *= 2
    after = measure_scan_noise(changed, bounds, plane(len(changed)), RATE, options).models
    same = [np.array_equal(a.white_mk2, b.white_mk2) for a, b in zip(before, after, strict=True)]
    assert same == [False, True, False]
    assert len(measure_scan_noise(data, bounds[:1], plane(len(data)), RATE, options).models) == 1


@pytest.mark.slow
def test_noise_of_other_scans_takes_no_sky():
    """Noise of its own scan fits the sky in it. 30 observations; errors are from their scatter."""
    rng, kept = np.random.default_rng(17), []
    index = np.array([rng.permutation(12) for _ in range(6 * 8)]).reshape(6, 96).astype(np.int32)
    bounds, sky = np.arange(8)[:, None] * 12 + [0, 12], rng.standard_normal(12) * 0.1
    sky -= sky.mean()
    for _ in range(30):
        noise = rng.standard_normal(index.shape)
        maps = []
        for own in (True, False):
            pair = []
            for data in (noise + sky[index], noise - sky[index]):
                options = GlsOptions((0.0, np.inf), max_modes=2, eigenvalue_cut=1.0, folds=4)
                found = measure_noise(data, bounds, plane(len(data)), RATE, options)
                model = found if own else measure_scan_noise(data, bounds, plane(len(data)), RATE, options)
                pair.append(solved(NormalBlock(index, bounds, model), data))
            maps.append((pair[0] - pair[1])[0] @ sky / (2 * sky @ sky))
        kept.append(maps)
    mean, error = np.mean(kept, axis=0), np.std(kept, axis=0) / np.sqrt(30)
    assert mean[0] < 1 - 5 * error[0]
    assert abs(mean[1] - 1) < 4 * error[1]
