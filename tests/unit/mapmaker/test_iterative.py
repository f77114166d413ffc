"""The loop of iterative map-making, with cleanings whose result is known."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.binning import BinnedMap, bin_map
from mapmaker.cleaning import TemplateOptions, clean
from mapmaker.geometry import MapGeometry
from mapmaker.iterative import IterationOptions, StreamBlock, iterate_map, significant, subtract_sky
from mapmaker.timestreams import FocalPlane

GEOMETRY = MapGeometry(2.3, 0.7, 1e-4, 6, 5)
NARROW = 1e-7  # a beam far below a pixel: smoothing does nothing
BOUNDS = np.array([[0, 20], [25, 45]])


def block(sky, seed=0, weight=1.0):
    """Three detectors that see random pixels of the sky, some samples off it."""
    rng = np.random.default_rng(seed)
    index = rng.integers(-1, sky.size, (3, 45)).astype(np.int32)
    data = np.append(sky.ravel(), 0.0)[index]
    return StreamBlock(data, index, BOUNDS, FocalPlane(np.arange(3.0), np.zeros(3), NARROW), weight)


def halved(item, kept=(True, True)):
    """A cleaning that takes half of everything."""
    whole = clean("none", item.data_mk, item.scan_bounds, item.focal_plane, options=TemplateOptions(1e-8, 1))
    return replace(whole, data_mk=item.data_mk / 2, kept=np.array(kept))


def bright_sky():
    sky = np.zeros((1, 5, 6))
    sky[0, 1, 2], sky[0, 3, 4] = 8.0, -8.0
    return sky


@pytest.mark.parametrize("passes", [1, 2, 5])
def test_each_pass_brings_back_half_of_what_is_missing(passes):
    item = block(bright_sky())
    options = IterationOptions(tolerance=1e-12, max_iterations=passes)
    result = iterate_map(GEOMETRY, lambda: [item], halved, options)
    np.testing.assert_allclose(result.map.signal_mk, bright_sky() * (1 - 0.5**passes), atol=1e-14)
    np.testing.assert_allclose(result.estimate_mk, bright_sky() * (1 - 0.5 ** (passes - 1)), atol=1e-14)
    assert result.iterations == len(result.change) == passes
    assert not result.converged
    # The estimate grows by 2^-k, to 1 - 2^-k.
    expected = [0.5**k / (1 - 0.5**k) for k in range(1, passes + 1)]
    np.testing.assert_allclose(result.change, expected, rtol=1e-12)


def test_it_ends_when_the_change_is_small():
    result = iterate_map(GEOMETRY, lambda: [block(bright_sky())], halved, IterationOptions(tolerance=0.01))
    assert result.converged
    # 2^-7 / (1 - 2^-7) is the first below 0.01.
    assert result.iterations == 7
    assert result.change[-1] < 0.01 < result.change[-2]


def test_a_map_without_signal_is_that_of_one_cleaning():
    rng = np.random.default_rng(1)
    item = block(np.zeros((5, 6)))
    noisy = StreamBlock(rng.standard_normal((3, 45)), item.index, BOUNDS, item.focal_plane)
    result = iterate_map(GEOMETRY, lambda: [noisy], halved, IterationOptions(threshold=20.0))
    once = bin_map(GEOMETRY, noisy.data_mk / 2, noisy.index, BOUNDS, kept=np.ones(2, bool))
    np.testing.assert_array_equal(result.map.signal_mk, once.signal_mk)
    assert result.converged and result.iterations == 1 and result.change == (0.0,)
    assert not result.estimate_mk.any()


def test_a_pixel_that_was_signal_stays_so():
    """From the second pass on, the cleaning leaves one pixel at a sixteenth of the other: below the floor."""
    sky = np.zeros((1, 5, 6))
    sky[0, 1, 2], sky[0, 3, 4] = 8.0, 8.0
    item, passes = block(sky), []

    def fading(left):
        passes.append(1)
        step = np.where(item.index == 3 * 6 + 4, -7.5, 0.0) if len(passes) == 2 else left.data_mk
        return replace(halved(item), data_mk=step)

    options = IterationOptions(loss=0.5, tolerance=1e-12, max_iterations=3)
    result = iterate_map(GEOMETRY, lambda: [item], fading, options)
    np.testing.assert_allclose([result.estimate_mk[0, 1, 2], result.estimate_mk[0, 3, 4]], [8.0, 0.5])


def test_observations_are_asked_for_at_each_pass_and_left_alone():
    asked = []
    item = block(bright_sky())
    before = item.data_mk.copy()

    def observations():
        asked.append(1)
        yield item

    result = iterate_map(GEOMETRY, observations, halved, IterationOptions(max_iterations=4, tolerance=1e-9))
    assert len(asked) == result.iterations == 4
    np.testing.assert_array_equal(item.data_mk, before)


def test_observations_have_their_weights():
    """Two observations of different skies: pixels are weighted means, hits count both."""
    one, two = block(bright_sky(), 1, weight=3.0), block(2 * bright_sky(), 2, weight=0.5)
    options = IterationOptions(max_iterations=1)
    result = iterate_map(GEOMETRY, lambda: [one, two], halved, options)
    maps = [bin_map(GEOMETRY, b.data_mk / 2, b.index, BOUNDS, kept=np.ones(2, bool)) for b in (one, two)]
    total = 3 * maps[0].weighted_sum + 0.5 * maps[1].weighted_sum
    np.testing.assert_allclose(result.map.weighted_sum, total, rtol=1e-14)
    np.testing.assert_array_equal(result.map.hits, maps[0].hits + maps[1].hits)


def test_discarded_scans_are_not_in_the_map():
    item = block(bright_sky())
    options = IterationOptions(max_iterations=2)
    result = iterate_map(GEOMETRY, lambda: [item], lambda b: halved(b, (False, True)), options)
    alone = bin_map(GEOMETRY, item.data_mk, item.index, BOUNDS, kept=np.array([False, True]))
    np.testing.assert_array_equal(result.map.hits, alone.hits)


def test_subtraction_is_per_pixel_and_spares_what_lies_off_the_map():
    item = block(bright_sky())
    left = subtract_sky(item, np.full((1, 5, 6), 2.0))
    np.testing.assert_array_equal(left.data_mk, item.data_mk - 2.0 * (item.index >= 0))
    single = StreamBlock(item.data_mk.astype(np.float32), item.index, BOUNDS, item.focal_plane)
    assert subtract_sky(single, bright_sky()).data_mk.dtype == np.float32


def map_of(values, weight):
    return BinnedMap(GEOMETRY, (values * weight)[None], weight[None], (weight > 0).astype(int)[None])


def test_significance_is_against_the_maps_own_scatter():
    """Deviates of both signs and size 1 have a scatter of 1.4826; weights count by their root."""
    weight = np.full((5, 6), 4.0)
    values = np.where(np.arange(30).reshape(5, 6) % 2, 0.5, -0.5)
    values[2, 2], values[4, 1] = -0.5 * 1.4826 * 5.01, 0.5 * 1.4826 * 4.99
    found = significant(map_of(values, weight), NARROW, 5.0, 0.0)
    assert np.argwhere(found[0]).tolist() == [[2, 2]]
    weight[4, 1] *= 1.1
    found = significant(map_of(values, weight), NARROW, 5.0, 0.0)
    assert np.argwhere(found[0]).tolist() == [[2, 2], [4, 1]]


def test_significance_is_a_share_of_the_brightest():
    values = np.zeros((5, 6))
    values[1, 1], values[2, 2], values[3, 3] = 10.0, -2.1, 1.9
    found = significant(map_of(values, np.ones((5, 6))), NARROW, 5.0, 0.2)
    assert np.argwhere(found[0]).tolist() == [[1, 1], [2, 2]]


def test_unobserved_pixels_are_never_significant():
    values, weight = np.zeros((5, 6)), np.ones((5, 6))
    values[2, 3] = 10.0
    weight[2, 4] = 0.0
    found = significant(map_of(values, weight), 2 * GEOMETRY.pixel_rad, 5.0, 0.0)
    assert found[0, 2, 2] and not found[0, 2, 4]
    assert not significant(map_of(values, np.zeros((5, 6))), NARROW, 5.0, 0.0).any()


def test_a_source_is_found_by_its_beam():
    """A beam-shaped source of 3 sigma a pixel, at a fifth of the beam: found smoothed, not pixel by pixel."""
    geometry = MapGeometry(2.3, 0.7, 1e-4, 60, 60)
    rng = np.random.default_rng(3)
    y, x = np.indices((60, 60))
    source = 3 * np.exp(-((x - 30) ** 2 + (y - 30) ** 2) * 4 * np.log(2) / 5**2)
    item = BinnedMap(
        geometry, source + rng.standard_normal((1, 60, 60)), np.ones((1, 60, 60)), np.ones((1, 60, 60), int)
    )
    assert significant(item, 5e-4, 5.0, 0.0)[0, 30, 30]
    assert not significant(item, NARROW, 5.0, 0.0)[0, 30, 30]


def test_noise_is_alike_where_the_weight_changes():
    """White noise on either side of a hundredfold step in weight: a sigma or more at 32 % of the points.

    The beam joins some 7 pixels along the step, which leaves 280 points of 2000: 5 sigma are 0.14.
    """
    rng = np.random.default_rng(4)
    weight = np.where(np.arange(60) < 30, 1.0, 100.0) * np.ones((1, 2000, 1))
    geometry = MapGeometry(2.3, 0.7, 1e-4, 60, 2000)
    item = BinnedMap(geometry, np.sqrt(weight) * rng.standard_normal(weight.shape), weight, weight.astype(int))
    found = significant(item, 2 * np.sqrt(8 * np.log(2)) * 1e-4, 1.0, 0.0)
    np.testing.assert_allclose(found[0, :, 24:36].mean(axis=0), 0.317, atol=0.14)


@pytest.mark.parametrize("values", [{"threshold": 0}, {"loss": 1.0}, {"tolerance": 0}, {"max_iterations": 0}])
def test_options_out_of_range(values):
    with pytest.raises(ValueError, match=f"{next(iter(values))}: found .* expected"):
        IterationOptions(**values)


def test_nothing_to_map():
    with pytest.raises(ValueError, match="found no observation"):
        iterate_map(GEOMETRY, lambda: [], halved, IterationOptions())


def test_index_that_does_not_fit():
    item = block(bright_sky())
    with pytest.raises(ValueError, match=r"index: found the shape \(3, 44\); \(3, 45\) is expected"):
        StreamBlock(item.data_mk, item.index[:, :-1], BOUNDS, item.focal_plane)
    beyond = replace(item, index=np.full_like(item.index, GEOMETRY.n_x * GEOMETRY.n_y))
    with pytest.raises(ValueError, match="index: found .* integers of at least -1 and of at most"):
        iterate_map(GEOMETRY, lambda: [beyond], halved, IterationOptions())
