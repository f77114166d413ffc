"""Polynomials of any order in regions: the named orders, twin, how the array is cut, planted signals."""

from dataclasses import replace

import numpy as np
import pytest

from mapmaker.cleaning import PolynomialOptions, TemplateOptions, clean, detectors_needed
from mapmaker.cleaning.polynomial import exponents, focal_plane_regions
from mapmaker.timestreams import FocalPlane
from tests import naive

BOUNDS = np.array([[0, 50], [50, 90]])


def _plane(n_det=48, seed=0):
    x, y = np.random.default_rng(seed).uniform(-1e-3, 1e-3, (2, n_det))
    return FocalPlane(x_rad=x, y_rad=y, fwhm_rad=1.5e-4)


def _data(n_det=48, seed=1):
    rng = np.random.default_rng(seed)
    c = 1 + 0.05 * rng.standard_normal((n_det, 1))
    return 20 + c * (10 * rng.standard_normal(90)) + rng.standard_normal((n_det, 90))


def _options(order, regions, tolerance=1e-8):
    return PolynomialOptions(order, regions, tolerance, 100)


def _lattice(n_x, n_y, jitter=0.0):
    x, y = np.meshgrid(np.arange(n_x), np.arange(n_y))
    noise = jitter * np.random.default_rng(0).standard_normal((2, n_x * n_y))
    return FocalPlane(1e-4 * (x.ravel() + noise[0]), 1e-4 * (y.ravel() + noise[1]), 1.5e-4)


def test_exponents_are_all_terms_up_to_the_order():
    assert exponents(0) == ((0, 0),)
    assert exponents(2) == ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
    assert [len(exponents(order)) for order in range(5)] == [1, 3, 6, 10, 15]


@pytest.mark.parametrize(("name", "order"), [("average", 0), ("planar", 1), ("quadratic", 2)])
def test_one_region_is_the_named_algorithm(name, order):
    expected = clean(name, _data(), BOUNDS, _plane(), options=TemplateOptions(1e-8, 100))
    found = clean("polynomial", _data(), BOUNDS, _plane(), options=_options(order, 1))
    np.testing.assert_allclose(found.data_mk, expected.data_mk, atol=1e-11)
    np.testing.assert_allclose(found.responsivity, expected.responsivity, rtol=1e-11)
    np.testing.assert_array_equal(found.iterations, expected.iterations)
    np.testing.assert_array_equal(found.removed, expected.removed)


def test_third_order_equals_the_loop_over_samples():
    plane, data = _plane(), _data()
    cleaned = clean("polynomial", data, BOUNDS, plane, options=_options(3, 1))
    shapes = np.stack([(plane.x_rad / 1e-3) ** a * (plane.y_rad / 1e-3) ** b for a, b in exponents(3)], axis=1)
    for s, (start, stop) in enumerate(BOUNDS):
        expected, c, steps = naive.template_cleaning(data[:, start:stop], shapes, True, 1e-8, 100)
        np.testing.assert_allclose(cleaned.data_mk[:, start:stop], expected, atol=1e-10)
        np.testing.assert_allclose(cleaned.responsivity[s], c, rtol=1e-9)
        assert cleaned.iterations[s] == steps and cleaned.removed[s] == 10


def test_regions_are_cleaned_each_on_its_own():
    plane, data = _plane(), _data()
    first = focal_plane_regions(plane, 3)[0]
    data[first] += 3 * np.random.default_rng(2).standard_normal((len(first), 90))
    cleaned = clean("polynomial", data, BOUNDS, plane, options=_options(1, 3))
    parts = [
        (region, clean("planar", data[region], BOUNDS, plane.subset(region), options=TemplateOptions(1e-8, 100)))
        for region in focal_plane_regions(plane, 3)
    ]
    for region, part in parts:
        np.testing.assert_allclose(cleaned.data_mk[region], part.data_mk, atol=1e-12)
        np.testing.assert_allclose(cleaned.responsivity[:, region], part.responsivity, rtol=1e-12)
    steps = np.array([part.iterations for _, part in parts])
    assert np.ptp(steps, axis=0).all()
    np.testing.assert_array_equal(cleaned.iterations, steps.max(axis=0))
    np.testing.assert_array_equal(cleaned.removed, 9)


@pytest.mark.parametrize("regions", [1, 2, 3, 4, 7, 48])
def test_regions_share_the_detectors_out(regions):
    found = focal_plane_regions(_plane(), regions)
    assert len(found) == regions
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), np.arange(48))
    assert np.ptp([len(region) for region in found]) <= 1


def test_regions_of_a_lattice_are_its_blocks_whatever_the_rounding():
    expected = [[0, 1, 2, 6, 7, 8], [12, 13, 14, 18, 19, 20], [3, 4, 5, 9, 10, 11], [15, 16, 17, 21, 22, 23]]
    for jitter in (0.0, 1e-12, 1e-9):
        assert [list(region) for region in focal_plane_regions(_lattice(6, 4, jitter), 4)] == expected
        column_cut = [0, 1, 2, 5, 6, 7, 10, 11, 15, 16]
        assert list(focal_plane_regions(_lattice(5, 4, jitter), 2)[0]) == column_cut


def test_the_wider_extent_is_cut_and_x_of_a_square():
    assert list(map(list, focal_plane_regions(_lattice(4, 4), 2))) == [
        [0, 1, 4, 5, 8, 9, 12, 13],
        [2, 3, 6, 7, 10, 11, 14, 15],
    ]
    assert list(map(list, focal_plane_regions(_lattice(1, 4), 2))) == [[0, 1], [2, 3]]


@pytest.mark.parametrize(("dtype", "level"), [(np.float64, 1e-11), (np.float32, 1e-6)])
@pytest.mark.parametrize(("order", "regions"), [(4, 1), (1, 4)])
def test_planted_polynomials_vanish(order, regions, dtype, level):
    rng = np.random.default_rng(5)
    plane, data = _plane(80), np.empty((80, 90))
    for region in focal_plane_regions(plane, regions):
        x, y = plane.x_rad[region] / 1e-3, plane.y_rad[region] / 1e-3
        shapes = np.stack([x**a * y**b for a, b in exponents(order)], axis=1)
        template = rng.standard_normal((len(exponents(order)), 90))
        template[0] *= 10
        data[region] = shapes @ template
    options = _options(order, regions, 1e-13 if dtype is np.float64 else 1e-8)
    cleaned = clean("polynomial", data.astype(dtype), BOUNDS, plane, options=options)
    assert cleaned.kept.all()
    assert np.abs(cleaned.data_mk).max() < level * np.abs(data).max()


def test_one_region_unconverged_discards_the_scan():
    data, plane = _data(), _plane()
    last = focal_plane_regions(plane, 2)[1]
    data[last, 50:] -= data[last, 50:] @ np.full((40, 40), 1 / 40)
    data[last[0], 50:] = 7.0
    cleaned = clean("polynomial", data, BOUNDS, plane, options=_options(0, 2))
    np.testing.assert_array_equal(cleaned.kept, [True, False])
    assert not cleaned.data_mk[:, 50:].any() and np.isnan(cleaned.responsivity[1]).all()


@pytest.mark.parametrize(("order", "regions", "needed"), [(0, 1, 2), (2, 3, 21), (3, 2, 22)])
def test_every_region_needs_more_detectors_than_terms(order, regions, needed):
    options = _options(order, regions)
    assert detectors_needed("polynomial", options) == needed
    clean("polynomial", _data(needed), BOUNDS, _plane(needed), options=options)
    with pytest.raises(ValueError, match="detectors, got"):
        clean("polynomial", _data(needed - 1), BOUNDS, _plane(needed - 1), options=options)


def test_more_regions_than_detectors():
    with pytest.raises(ValueError, match="9 regions need at least as many detectors, got 3"):
        focal_plane_regions(_plane(3), 9)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"order": -1}, "order: found -1; an integer of at least 0"),
        ({"regions": 0}, "regions: found 0; an integer of at least 1"),
        ({"tolerance": np.nan}, "tolerance: found nan; a finite number above 0"),
        ({"max_iterations": 0}, "max_iterations: found 0; an integer of at least 1"),
    ],
)
def test_options_out_of_range(changed, message):
    with pytest.raises(ValueError, match=message):
        replace(_options(1, 1), **changed)
