"""Map-makers of the command: those of the package on the same streams, with noise maps."""

import healpy
import numpy as np
import pytest

import mapmaker as mm
from mapmaker.binning import map_shape
from mapmaker.destriping import DestripeOptions, destriped_map
from mapmaker.geometry import plane_offsets
from mapmaker.gls import GlsOptions, gls_map
from mapmaker.normal_equations import SolveOptions
from mapmaker.pipeline.config import Config
from mapmaker.pipeline.mapped_file import mapped_file
from mapmaker.pipeline.one_file import clean_file
from mapmaker.pipeline.run import clean_and_map, sample_weights
from tests.unit.mapmaker.pipeline.made import RATE_HZ, SOURCE_MK, streams, written


def config(maker, cleaning="none", **options):
    section = {"maker": maker, "pixel": "60 arcsec", "healpix_nside": 2048, **({maker: options} if options else {})}
    return Config.model_validate({"cleaning": [{"algorithm": cleaning}], "map": section})


def blocks(items, geometry, settings):
    for k, item in enumerate(items):
        cleaned = clean_file(f"{k}", item, settings)
        file = mapped_file(
            geometry, cleaned, sample_weights(cleaned, "detector"), splits=[], place=(k, len(items)), order={}
        )
        yield mm.StreamBlock(cleaned.cleaned_mk, file.index, cleaned.bounds, cleaned.streams.focal_plane)


@pytest.mark.parametrize("maker", ["destriped", pytest.param("maximum_likelihood", marks=pytest.mark.slow)])
def test_solved_maps_are_those_of_the_package(maker, tmp_path):
    items, settings = [streams(k, drift_mk=3.0) for k in range(2)], config(maker, tolerance=1e-6)
    found = clean_and_map(written(tmp_path, items), settings).maps
    geometry, solve = found.map.geometry, SolveOptions(1e-6)
    of_blocks = [*blocks(items, geometry, settings)]
    if maker == "destriped":
        expected = destriped_map(geometry, lambda: of_blocks, DestripeOptions(round(2 * RATE_HZ), solve))
    else:
        options = GlsOptions((0.0, 0.1, 0.2, 0.4, 0.8, 1.6, np.inf), 20, solve=solve)
        expected = gls_map(geometry, lambda: of_blocks, sample_rate_hz=RATE_HZ, options=options)
    np.testing.assert_array_equal(found.map.hits, expected.map.hits)
    np.testing.assert_allclose(found.map.weight, expected.map.weight, rtol=1e-6)
    # Both stop at a residual of 1e-6, with streams in files of single precision for one of them.
    np.testing.assert_allclose(found.map.signal_mk, expected.map.signal_mk, atol=2e-3)
    assert found.converged and "converged in" in found.solution
    check_healpix(found)


def check_healpix(maps):
    """The same data in other pixels: as many, of the same sum, and equal to the map but for white noise."""
    flat, sums, geometry = maps.map, maps.healpix, maps.map.geometry
    assert sums.hits.sum() == flat.hits.sum()
    np.testing.assert_allclose(sums.weight.sum(), flat.weight.sum(), rtol=1e-9)
    # The streams without the map have no sum, but for the residual of the solution.
    difference = sums.weighted_sum.sum() - np.sum(flat.weight * flat.signal_mk)
    assert abs(difference) < 1e-3 * np.sqrt(flat.weight.sum())
    deep = sums.weight > 0.3 * sums.weight.max()
    ra, dec = np.radians(healpy.pix2ang(sums.nside, sums.pixels[deep], nest=True, lonlat=True))
    xi, eta = plane_offsets(geometry, ra, dec) / np.array(geometry.pixel_rad)
    at = 0, np.floor(eta + geometry.n_y / 2).astype(int), np.floor(geometry.n_x / 2 - xi).astype(int)
    difference = sums.weighted_sum[deep] / sums.weight[deep] - flat.signal_mk[at]
    scatter = 1.4826 * np.median(np.abs(difference) * np.sqrt(flat.weight[at]))
    # White noise of 1, and that of a pixel of three times the area; drifts that are solved for are 7 times as large.
    assert len(difference) > 100 and scatter == pytest.approx(np.sqrt(1 + 1 / 3), abs=0.35)


@pytest.mark.slow
def test_noise_maps_of_destriped_white_noise(tmp_path):
    """Unit variance for the white weights, but for long waves and the noise of the map that is subtracted."""
    items = [streams(k, drift_mk=0.0, source_mk=5.0) for k in range(4)]
    found = clean_and_map(written(tmp_path, items), config("destriped", baseline="60 s")).maps
    assert [split.kind for split in found.splits] == ["files"] * 2 + ["time", "direction", "detectors"]
    for item in found.noise:
        seen = item.weight > 0.2 * item.weight.max()
        assert seen.sum() > 80 and item.signal_mk.shape == map_shape(item.geometry)
        scatter = 4 / np.sqrt(2 * seen.sum())
        assert np.std((item.signal_mk * np.sqrt(item.weight))[seen]) == pytest.approx(1, abs=0.08 + scatter)


def test_iteration_brings_the_flux_back(tmp_path):
    """The template of 25 detectors contains a part of the source, which one pass removes."""
    paths = written(tmp_path, [streams(k) for k in range(4)])
    once, iterated = (clean_and_map(paths, config(maker, "average")).maps for maker in ("binned", "iterative"))
    peaks = [float(item.map.signal_mk.max()) for item in (once, iterated)]
    # 60 arcsec pixels average the beam of 90 arcsec to 0.83 of its peak or less.
    assert peaks[1] > 1.03 * peaks[0] and peaks[1] < SOURCE_MK
    assert iterated.converged and iterated.map.hits.sum() == once.map.hits.sum()
    assert len(iterated.noise) == 5
