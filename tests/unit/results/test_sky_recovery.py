"""The scene's own sky and what comes back of it: inputs, transfer functions, fluxes, files."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import QTable
from astropy.wcs import WCS
from scipy.ndimage import correlate1d

import mapmaker as mm
from mapmaker.geometry import pixel_centres
from surveysim import run
from surveysim.reduction.input_map import input_map
from surveysim.reduction.setup import prepare
from surveysim.report.figures.survey import survey_figures
from surveysim.results.sky_fluxes import _noise_psd, _scatter
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene
from tests.scenes import SMALL_SCENE, write_scene

SOURCES = """\
[[sky.clusters]]
ra = "08h49m12s"
dec = "+44d47m00s"
y0 = 4e-3
profile = "beta"
core_radius = "40 arcsec"
beta = 0.9

[cleaning]
"""
# Without noise, and with responsivities of 1: maps of the sky alone.
NOISELESS = {
    "photon": None,
    "detector": None,
    "excess": None,
    "atmosphere": None,
    "instrument.responsivity_scatter": 0,
    "cleaning.algorithm": "none",
    "score.noise_only_sets": [],
    "score.mask_separation_f_lambda": None,
    "score.ell_bin": 1000,
    "score.signal_sims.skies": 6,
    "score.signal_sims.observations": 4,
    "scan.step": "1 arcmin",
    "scan.scans": 12,
    "map.pixel": "20 arcsec",
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """(result, folder) of a small noiseless survey."""
    folder = tmp_path_factory.mktemp("sky")
    path = write_scene(folder, SMALL_SCENE.replace("[cleaning]\n", SOURCES))
    return run(load_scene(path, NOISELESS), folder / "out", engine=SERIAL, figures=False), folder / "out"


def test_input_is_the_mean_over_pixels(finished):
    """Of a wave along both axes: sinc of its phase across half a pixel, where look-ups are bilinear between cells."""
    analysis = finished[0].setup.analysis
    patch, phase = analysis.region.patch, 0.4  # from cell to cell
    xi, eta = (plane / analysis.sky_geometry.pixel_rad for plane in pixel_centres(analysis.sky_geometry))
    column, row = (plane[patch, patch] / analysis.sky_geometry.pixel_rad for plane in pixel_centres(analysis.geometry))
    found = input_map(analysis, np.cos(phase * xi + 0.5 * phase * eta)[None])
    left = math.prod((math.sin(p) / p) * (math.sin(p / 2) / (p / 2)) ** 2 for p in (phase, 0.5 * phase))
    np.testing.assert_allclose(found, left * np.cos(phase * column + 0.5 * phase * row), atol=2e-4)


def test_a_sky_comes_back(finished):
    """Within three errors in each scored bin and in all of them, and nearly the same map as went in."""
    item = finished[0].sky["actual"]
    scored = finished[0].setup.analysis.region.selected
    assert abs(item.total - 1) < 3 * item.total_error < 0.06
    # Of 8 bins, with errors from six skies.
    assert (np.abs(item.recovered - 1)[scored] < 4 * item.recovered_error[scored]).all()
    assert (item.correlation[scored] > 0.97).all()
    assert item.transfer[scored].min() > 0.8 and item.transfer[scored].max() < 1.05


def test_fluxes_of_a_source_and_a_cluster(finished):
    """In: the closed form of a Gaussian in a compensated aperture, within its pixels. Out: within 5 % of it."""
    result, _ = finished
    cluster, source = result.sky["actual"].fluxes
    assert (cluster.kind, source.kind) == ("cluster", "point source")
    # A disc of one width less a ring of equal area around it, and half of the pixels along the edge of the disc.
    expected = 1 - 2 * 2.0**-4 + 2.0**-8
    assert source.input_mjy / source.catalogue_mjy == pytest.approx(expected, abs=0.06)
    assert source.ratio == pytest.approx(1, abs=0.05) and cluster.ratio == pytest.approx(1, abs=0.1)
    assert cluster.input_mjy < 0 and math.isnan(cluster.catalogue_mjy)
    assert source.measured_mjy == pytest.approx(source.output_mjy, rel=0.02)
    assert 0 < source.error_mjy < 0.2 * source.measured_mjy


def test_noise_of_a_flux():
    """White noise of uneven weights, smoothed: the closed form of its kernel, to the scatter of six maps."""
    rng, n = np.random.default_rng(3), 64
    taper = mm.tukey_taper(n, n, 1.0, size_rad=n, edge_fraction=0.5)
    region = SimpleNamespace(taper=taper, pad=lambda maps: np.pad(maps, [(0, 0)] * (maps.ndim - 2) + [(0, n)] * 2))
    weight = np.exp(np.linspace(-1, 1, n))[:, None] * np.ones(n)
    kernel = np.array([0.5, 1, 0.5])
    noise = correlate1d(correlate1d(rng.normal(size=(6, n, n)), kernel, axis=1), kernel, axis=2) / np.sqrt(weight)
    aperture = np.zeros((n, n))
    aperture[40:43, 30:33] = 1
    psd = _noise_psd(SimpleNamespace(region=region), noise, weight)
    expected = np.sum(np.convolve(np.ones(3), kernel) ** 2) / np.sqrt(weight[41, 31])
    # Six maps with 64^2 / 40 independent apertures each, a third of them under the taper.
    assert _scatter(aperture, weight, psd) == pytest.approx(expected, rel=4 / np.sqrt(2 * 6 * 64**2 / 40 / 3))


def test_files_of_the_sky(finished):
    """Images with the coordinates of the map, and tables with units."""
    result, out = finished
    item = result.sky["actual"]
    with fits.open(out / "maps" / "sky_actual.fits") as file:
        assert [hdu.name for hdu in file[1:]] == ["INPUT", "OUTPUT", "WEIGHT", "TRANSFER"]
        np.testing.assert_allclose(file["OUTPUT"].data, item.output_mk, rtol=1e-6)
        source = result.setup.scene.sky.point_sources[0]
        column, row = WCS(file["INPUT"].header).world_to_pixel_values(*np.degrees([source.ra_rad, source.dec_rad]))
        peak = np.unravel_index(np.argmax(file["INPUT"].data), file["INPUT"].data.shape)
        assert peak == (round(float(row)), round(float(column)))
        plane = file["TRANSFER"].header
        assert (plane["CDELT1"], plane["CTYPE1"], plane["NAXIS2"]) == (1000, "ELL_X", 2 * plane["NAXIS1"])
    fluxes = QTable.read(out / "tables" / "sky_fluxes.ecsv")
    assert fluxes["input"].unit == "mJy" and list(fluxes["source"]) == ["cluster 0", "point source 0"]
    transfer = QTable.read(out / "tables" / "sky_transfer.ecsv")
    np.testing.assert_allclose(transfer["recovered_actual"], item.recovered)
    page = (out / "report.html").read_text()
    assert "Sky in and out" in page and "point source 0" in page


def test_figure_of_the_sky(finished):
    figure = survey_figures(finished[0])["sky"]()
    assert "Transfer function (amplitude)" in [axes.get_title() for axes in figure.axes]


def test_without_a_sky_or_a_score_there_is_nothing(tmp_path):
    path = write_scene(tmp_path)
    for absent in ("sky", "score"):
        analysis = prepare(load_scene(path, {absent: None})).analysis
        assert analysis.own_sky is None and analysis.n_signal_skies == (2 if absent == "sky" else 0)
