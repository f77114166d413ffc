"""Sums of the maps: weights, halves whose sky cancels, HEALPix pixels without holes, PSDs of the noise."""

from dataclasses import replace

import healpy
import numpy as np
import pytest

from mapmaker.geometry import MapGeometry, pixel_indices
from mapmaker.kernels.weighted_sums import add_weighted
from mapmaker.pipeline.config import Config, JackknifeSection
from mapmaker.pipeline.mapped_file import mapped_file
from mapmaker.pipeline.noise_spectra import coverage_taper, noise_spectra
from mapmaker.pipeline.one_file import clean_file
from mapmaker.pipeline.run import clean_and_map, sample_weights
from mapmaker.pipeline.splits import first_half, make_splits
from mapmaker.pipeline.sums import MapSums
from tests import naive
from tests.unit.mapmaker.pipeline.made import ARCMIN, CENTRE, N_DET, N_SCAN, WHITE_MK, streams, written

GEOMETRY = MapGeometry(*np.radians(CENTRE), ARCMIN / 2, 60, 60)
NONE = Config.model_validate({"cleaning": [{"algorithm": "none"}]})


def test_weighted_sums():
    rng = np.random.default_rng(0)
    data, index = rng.standard_normal((4, 50)), rng.integers(-1, 9, (4, 50))
    bounds, weight = np.array([[2, 20], [25, 50]]), np.array([[1.0, 2.0], [0.0, 3.0], [0.5, 0.0], [0.0, 0.0]])
    sums = np.zeros(9), np.zeros(9), np.zeros(9, np.int64)
    add_weighted(data, index, bounds, weight, *sums)
    for found, expected in zip(sums, naive.add_weighted_samples(data, index, bounds, weight, 9), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_halves_of_files():
    section = JackknifeSection(files=5, splits=("files",))
    for n_file, wanted in ((1, 0), (2, 1), (4, 3), (9, 5)):
        halves = [item.first_files for item in make_splits(section, n_file) if item.kind == "files"]
        assert len(set(halves)) == len(halves) == wanted
        assert all(len(half) == n_file // 2 and max(half, default=0) < n_file for half in halves)
    assert make_splits(section, 9) == make_splits(section, 9)


@pytest.mark.parametrize("n_file", [2, 4, 6])
def test_no_division_is_there_twice(n_file):
    """The division in time of an even number of files is one by files."""
    splits = make_splits(JackknifeSection(files=20), n_file)
    later = frozenset(range(n_file // 2, n_file))
    assert later not in [item.first_files for item in splits] and "time" in [item.name for item in splits]


def test_halves_of_one_file():
    item = clean_file("a", streams(0), Config())
    order = {f"d{k:02d}": k for k in range(N_DET)}
    halves = {split.kind: first_half(split, item, (0, 1), order) for split in make_splits(JackknifeSection(), 1)}
    assert list(halves) == ["time", "direction", "detectors"]
    np.testing.assert_array_equal(halves["time"][0], np.arange(N_SCAN) < N_SCAN / 2)
    np.testing.assert_array_equal(halves["direction"][3], np.arange(N_SCAN) % 2 == 0)  # to the east
    np.testing.assert_array_equal(halves["detectors"][:, 2], np.arange(N_DET) % 2 == 0)


def sums_of(config, items, nside=None, uniform=False):
    sums = MapSums(GEOMETRY, make_splits(config.jackknives, len(items)), uniform, nside)
    for k, item in enumerate(items):
        cleaned = clean_file(f"{k}", item, config)
        weight = sample_weights(cleaned, "uniform" if uniform else "detector")
        sums.add(mapped_file(GEOMETRY, cleaned, weight, splits=sums.splits, place=(k, len(items)), order={}))
    return sums


def test_a_sky_without_noise_cancels_in_all_halves():
    """In pixels that both halves see, whatever their weights: the sky has one value a pixel."""
    items = []
    for k in range(4):
        item = streams(k, source_mk=0.0, drift_mk=0.0, white_mk=0.0)
        sky = np.append(np.random.default_rng(9).standard_normal(GEOMETRY.n_x * GEOMETRY.n_y), 0.0)
        items.append(replace(item, data_mk=sky[pixel_indices(GEOMETRY, item)]))
    sums = MapSums(GEOMETRY, make_splits(NONE.jackknives, 4), False, None)
    for k, item in enumerate(items):
        cleaned = clean_file(f"{k}", item, NONE)
        cleaned = replace(cleaned, cleaned_mk=item.data_mk)  # with its means
        weight = np.linspace(1, 2 + k, N_DET)
        sums.add(mapped_file(GEOMETRY, cleaned, weight, splits=sums.splits, place=(k, 4), order={}))
    assert len(sums.splits) == 5
    for k in range(5):
        noise = sums.noise_map(k)
        assert (noise.weight > 0).sum() > 200 and np.abs(noise.signal_mk).max() < 1e-12
    seen = sums.hits[0] > 0
    np.testing.assert_allclose((sums.weighted_sum[0] / np.where(seen, sums.weight[0], 1))[seen], sky[:-1][seen])


def test_psds_of_white_noise():
    """For any coverage of the halves they are that of the mean noise of the map."""
    items = [streams(k, source_mk=0.0, drift_mk=0.0) for k in range(6)]
    sums = sums_of(NONE, items)
    fwhm = items[0].focal_plane.fwhm_rad
    found, weight = noise_spectra(sums.maps(), fwhm), sums.map().weight[0]
    taper = coverage_taper(sums.map(), fwhm)
    expected = np.sum(taper[weight > 0] ** 2 / weight[weight > 0]) / np.sum(taper**2) * GEOMETRY.pixel_rad**2
    assert weight.sum() == pytest.approx(sums.hits[0].sum() / WHITE_MK**2, rel=0.05)
    high = found.ell > 4000  # the means of scans take long waves
    for name, psd, n_modes in zip(found.names, found.psd_mk2, found.n_modes, strict=True):
        error = np.sqrt(2 / n_modes[high].sum())
        assert np.average(psd[high], weights=n_modes[high]) / expected == pytest.approx(1, abs=4 * error + 0.03), name
    assert found.coverage.min() > 0.1


@pytest.mark.parametrize("centre", [(0.0, -89.9), pytest.param((359.99, 0.0), marks=pytest.mark.slow)])
def test_healpix_maps_are_those_of_the_directions(centre, tmp_path):
    """Each sample goes to the pixel of its direction, computed apart; there is no hole."""
    items = [streams(k, centre) for k in range(2)]
    config = Config.model_validate({"map": {"healpix_nside": 2048, "weights": "uniform"}})
    maps = clean_and_map(written(tmp_path, items), config).maps
    found, hits = maps.healpix, np.zeros(12 * 2048**2, int)
    assert found.hits.sum() == maps.map.hits.sum()
    assert found.weighted_sum.sum() == pytest.approx(maps.map.weighted_sum.sum())
    for item in items:
        inside = item.scan >= 0
        vector = healpy.ang2vec(np.pi / 2 - item.dec_rad, item.ra_rad)
        pole = np.array([0.0, 0.0, 1.0])
        east = np.cross(pole, vector)
        east /= np.linalg.norm(east, axis=1)[:, None]
        north = np.cross(vector, east)
        cos, sin = np.cos(item.array_angle_rad)[:, None], np.sin(item.array_angle_rad)[:, None]
        for x, y in zip(item.focal_plane.x_rad, item.focal_plane.y_rad, strict=True):
            line = vector + east * (y * sin - x * cos) + north * (x * sin + y * cos)
            pixel = healpy.vec2pix(2048, *line[inside].T, nest=True)
            np.add.at(hits, pixel, 1)
    seen = np.flatnonzero(hits)
    np.testing.assert_array_equal(found.pixels[found.hits > 0], seen)
    np.testing.assert_array_equal(found.hits[found.hits > 0], hits[seen])
