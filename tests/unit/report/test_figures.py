"""Figures of a tiny made-up survey: which files there are, and that the lines are the results."""

from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest

from mapmaker.geometry import MapGeometry, wcs
from mapmaker.report.figures import sky_ticks
from surveysim.reduction.setup import Setup, prepare
from surveysim.report.figures import survey as figures
from surveysim.report.figures.observations import timestream_psd
from surveysim.report.figures.run_time import time_figure
from surveysim.report.figures.sky_map import map_planes
from surveysim.report.figures.sky_recovery import sky_in_and_out
from surveysim.report.figures.spectra import cumulative_sensitivity, map_psds
from surveysim.results.results import survey_result
from surveysim.scene.scene import load_scene
from surveysim.survey.coadds import CoAdds, empty_coadds
from surveysim.survey.run import run_observations
from surveysim.survey.scores import DataSetScore, score_survey

LYNX = Path(__file__).parents[3] / "scenarios" / "lynx.toml"
TINY = {
    "observations": 4,
    "instrument.layout.rings": 2,
    "instrument.layout.dead": [],
    "scan.scans": 4,
    "scan.step": "4 arcmin",
    "scan.duration": "5 s",
    "map.pixel": "1 arcmin",
    "score.size": "16 arcmin",
    "score.ell_bin": 1000,
    "score.ell_min": 3000,
    "score.ell_max": 10000,
    "score.jackknives": 4,
    "score.signal_sims.skies": 2,
    "score.signal_sims.observations": 4,
}
PLACE = {"schedule.latitude": "19.8 deg", "schedule.longitude": "-155.5 deg", "schedule.height": "4 km"}
CALM = PLACE | {"atmosphere": None, "excess": None, "score": None, "cleaning.algorithm": "none", "observations": 1}


@pytest.fixture(scope="module")
def setup() -> Setup:
    return prepare(load_scene(LYNX, TINY))


@pytest.fixture(scope="module")
def coadds(setup: Setup) -> CoAdds:
    return run_observations(setup, None)


@pytest.fixture(scope="module")
def scores(setup: Setup, coadds: CoAdds) -> dict[str, DataSetScore]:
    return score_survey(setup, coadds)


def _curve(figure: matplotlib.figure.Figure, label: str) -> np.ndarray:
    (line,) = (line for line in figure.axes[0].lines if label in line.get_label())
    return np.array(line.get_data())


def test_all_figures(setup, coadds):
    """In the order of the report, whose tests render them."""
    drawings = figures.drawings(survey_result(setup, coadds, wall_s=1.0, workers=1))
    without = [name for name in figures.TITLES if name not in ("sky", "spectra")]  # no such sections
    assert list(drawings) == [*without, figures.RUN_TIME]


def test_scene_with_little_to_show(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "save", lambda *arguments: None)  # drawing is what takes time
    setup = prepare(load_scene(LYNX, {key: TINY[key] for key in TINY if "score" not in key} | CALM))
    coadds = run_observations(setup, None)
    drawings = figures.drawings(survey_result(setup, coadds, wall_s=1.0, workers=1))
    assert list(drawings) == ["track", "timestream_psd", "map"]
    for name, draw in drawings.items():
        draw(tmp_path / name)
    assert len(timestream_psd(setup, coadds).axes) == 1


def test_nothing_observed_gives_no_figures(setup):
    assert (
        figures.drawings(SimpleNamespace(setup=setup, coadds=empty_coadds(setup.analysis), scores={}, expected=None))
        == {}
    )


def test_timestream_psd_of_the_calmest_and_the_worst(setup, coadds):
    figure = timestream_psd(setup, coadds)
    kept = [number for number, psd in enumerate(coadds.clean_psd) if psd.any()]
    order = sorted(kept, key=lambda number: coadds.rows[number][1])
    for axes, observation in zip(figure.axes, (order[0], order[-1]), strict=True):
        frequency, raw = axes.lines[0].get_data()
        assert frequency[0] == pytest.approx(1 / 5) and frequency[-1] == pytest.approx(4.8)
        np.testing.assert_array_equal(raw, coadds.raw_psd[observation][1:-1])
        np.testing.assert_array_equal(axes.lines[1].get_ydata(), coadds.clean_psd[observation][1:-1])


def test_lines_of_error_against_time_are_functions_of_time(setup, coadds):
    """No time has two errors, and this run says which times it counts."""
    figure = time_figure(survey_result(setup, coadds, wall_s=100.0, workers=1))
    alone, dashed, own = figure.panels[0].series
    for line in (alone, dashed):
        assert len(set(line.x)) == len(line.x) and (np.diff(line.y[np.argsort(line.x)]) < 0).all()
    assert own.label.startswith("this run: ") and own.label.endswith("of simulation, 1.7 min from start to score")


def test_masked_psd_is_that_of_as_many_detectors(setup, scores):
    masked = scores["masked_7"]
    _, psd = _curve(map_psds(setup, scores), "masked")
    np.testing.assert_allclose(psd, masked.noise_psd[1:] * 7 / 19)


def test_a_mask_may_keep_all_detectors():
    """Detectors that are farther apart than the mask asks for: a data set like the actual one."""
    setup = prepare(load_scene(LYNX, TINY | {"instrument.layout.pitch_f_lambda": 1.4}))
    found = score_survey(setup, run_observations(setup, None))
    figure = map_psds(setup, found)
    assert found["masked_19"].n_det == setup.camera.n_det == 19
    np.testing.assert_allclose(_curve(figure, "masked_19_scaled"), _curve(figure, "actual"))


def test_cumulative_sensitivity_at_the_scored_range_is_the_score(setup, scores):
    starts, sigma = _curve(cumulative_sensitivity(setup, scores), "actual")
    assert starts[0] == 1000
    assert sigma[starts == 3000] == pytest.approx(scores["actual"].band.sigma_ukcmb2)
    assert (np.diff(sigma) >= 0).all()


def test_map_in_cmb_temperature(setup, coadds):
    signal, noise = map_planes(setup, coadds)
    seen = np.isfinite(noise)
    assert 0.2 < seen.mean() < 1
    assert np.isfinite(signal[seen]).all()
    # 1 mK Rayleigh-Jeans is 1650 uK of the CMB at 143 GHz.
    np.testing.assert_allclose(noise[seen], 1650 / np.sqrt(coadds.weight[0][seen]), rtol=0.01)


def test_sky_in_and_out_have_one_scale():
    """A mean that cleaning removes is no difference of colour; a source is, by what it lost."""
    geometry = MapGeometry(*np.radians([132.3, 44.8]), np.radians(0.01), 40, 40)
    source = np.zeros((40, 40))
    source[18:22, 18:22] = 1
    maps = {"input_mk": source + 5, "output_mk": 0.9 * source, "weight": np.ones((40, 40))}
    figure = sky_in_and_out(
        SimpleNamespace(geometry=geometry, bin_width=500, transfer_plane=np.ones((4, 2)), **maps), 1.0
    )
    images = [axes.images[0] for axes in figure.axes if axes.images]
    assert len(figure.axes) == 5  # three panels, two colour bars
    assert images[0].get_clim() == images[1].get_clim() == pytest.approx((-900, 900))
    assert [image.get_array().max() for image in images[:2]] == pytest.approx([1000, 900])


@pytest.mark.parametrize(("ra", "dec"), [(132.3, 44.8), (0.0, -55.0), (15.0, 89.7)])
def test_ticks_of_a_map_are_where_the_world_coordinates_are(ra, dec):
    """On the lower and the left edge, across RA 0 and at a pole too."""
    geometry = MapGeometry(*np.radians([ra, dec]), np.radians(0.01), 120, 100)
    (columns, ra_labels), (rows, dec_labels) = sky_ticks(geometry)
    assert 3 <= len(columns) <= 8 and 2 <= len(rows) <= 8
    below, _ = wcs(geometry).wcs_pix2world(columns, np.full(len(columns), -0.5), 0)
    _, left = wcs(geometry).wcs_pix2world(np.full(len(rows), -0.5), rows, 0)
    for found, labels in ((below, ra_labels), (left, dec_labels)):
        shown = np.array([float(label.rstrip("\N{DEGREE SIGN}")) for label in labels])
        np.testing.assert_allclose((found - shown + 180) % 360 - 180, 0, atol=1e-3)
