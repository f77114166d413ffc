"""Figures 10 to 13 of the paper: streams and results made by hand, whose spectra and shares are known beforehand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mapmaker.cleaning import Cleaned
from mapmaker.cleaning.templates import PLANAR, QUADRATIC, template_streams
from mapmaker.stream_psd import hann_psd
from mapmaker.timestreams import FocalPlane
from surveysim.paper.figures import cleaning as cleaning_figures
from surveysim.paper.figures.cleaning import (
    beam_power,
    cleaning_cost,
    frequencies,
    halfway_out,
    pca_figure,
    template_figure,
    template_psds,
    timestream_figure,
    weather_examples,
)
from surveysim.paper.figures.maps import log_bin_sigma, map_psd_figure, pipeline_names, winners
from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.reduction.setup import prepare
from surveysim.results.results import SurveyResult, survey_result
from surveysim.scene.scene import load_scene
from surveysim.survey.error_modes import gain
from surveysim.survey.rows import row_names
from surveysim.survey.run import run_observations
from surveysim.survey.scores import rescore
from tests.scenes import write_scene

WIND_RAD_S = np.array([0.01, 0.0])
N = 60  # samples of a scan


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def setup(path):
    return prepare(load_scene(path, {"observations": 8}).model_copy(update={"score": None}))


def survey(setup, b2, flags=None, scenes=None) -> MeasuredSurvey:
    """Observations of fitted B2, NaN for none, whose winds are flagged or trusted."""
    flags = flags or [""] * len(b2)
    items = tuple(
        SimpleNamespace(observation=k, wind=SimpleNamespace(flag=flag, velocity_rad_s=WIND_RAD_S))
        for k, flag in enumerate(flags)
    )
    grid = SimpleNamespace(height_m=np.array([1000.0]))
    fits = [None if np.isnan(value) else SimpleNamespace(b2=np.full((99, 1), value)) for value in b2]
    return MeasuredSurvey(setup, tuple(scenes or ["small"] * len(b2)), items, None, grid, None, tuple(fits))


@pytest.fixture(scope="module")
def measured(setup):
    return survey(setup, [10.0, 100.0, 1000.0, 10000.0])


def named(panel, label):
    return next(series for series in panel.series if label in series.label)


# ---------------------------------------------------------------- templates


def test_template_streams_are_the_terms_at_the_place():
    rng = np.random.default_rng(5)
    x, y = rng.uniform(-1e-3, 1e-3, (2, 20)) + [[3e-3], [-1e-3]]
    plane, bounds = FocalPlane(x, y, 1e-4), np.array([[0, 40], [45, 85]])
    amplitudes, c = rng.standard_normal((3, 90)), 1 + 0.1 * rng.standard_normal((2, 20))
    for start, stop in bounds:
        amplitudes[:, start:stop] -= amplitudes[:, start:stop].mean(axis=1, keepdims=True)
    u, v = (x - x.mean()) / 1e-3, (y - y.mean()) / 1e-3
    data = np.full((20, 90), 7.0)
    for (start, stop), gains in zip(bounds, c, strict=True):
        common = amplitudes[0] + np.outer(u, amplitudes[1]) + np.outer(v, amplitudes[2])
        data[:, start:stop] += (gains[:, None] * common)[:, start:stop]
    place = (x.mean() + 0.5e-3, y.mean() - 0.25e-3)
    found = template_streams(data, bounds, plane, responsivity=c, exponents=PLANAR, place_rad=place)
    expected = amplitudes * np.array([[1.0], [0.5], [-0.25]])
    for start, stop in bounds:
        np.testing.assert_allclose(found[:, start:stop], expected[:, start:stop], atol=1e-12)
    assert not found[:, 40:45].any() and not found[:, 85:].any()
    # Of higher orders it has none; a discarded scan is 0.
    c[1] = np.nan
    found = template_streams(data, bounds, plane, responsivity=c, exponents=QUADRATIC, place_rad=place)
    np.testing.assert_allclose(found[:3, :40], expected[:, :40], atol=1e-11)
    assert np.abs(found[3:]).max() < 1e-11 and not found[:, 45:].any()


def test_template_streams_of_detectors_on_a_line_are_refused():
    line = FocalPlane(np.linspace(0, 1e-3, 9), np.zeros(9), 1e-4)
    with pytest.raises(ValueError, match="they lie on one line"):
        template_streams(
            np.ones((9, 20)),
            np.array([[0, 20]]),
            line,
            responsivity=np.ones((1, 9)),
            exponents=PLANAR,
            place_rad=(0.0, 0.0),
        )


def test_templates_halfway_out_have_an_eighth_of_the_power_of_the_edge(setup, measured):
    """(1 + x / R) cos: the gradient at x = R / 2 cos 45 deg has the square of 1 / 8^(1/2) of the constant's power."""
    one = weather_examples(measured)[0]
    plane, n_scans = one.streams.focal_plane, setup.observing.scans.n_scans
    from_centre = plane.x_rad - plane.x_rad.mean()
    radius = np.hypot(from_centre, plane.y_rad - plane.y_rad.mean()).max()
    wave = np.cos(2 * np.pi * 5 * (np.arange(N * n_scans) + 0.5) / N)
    data = np.outer(1 + from_centre / radius, wave)
    psds = template_psds(replace(one, streams=replace(one.streams, data_mk=data)))
    alone = hann_psd(wave[None], n_scans, np.ones(n_scans, bool), 10.0)[0, 1 : N // 2]
    peak = alone > 1e-3 * alone.max()
    np.testing.assert_allclose(psds[0, peak], alone[peak], rtol=1e-6)
    np.testing.assert_allclose(psds[1, peak], alone[peak] / 8, rtol=1e-6)
    assert psds[2:, peak].max() < 1e-6 * alone.max()
    np.testing.assert_allclose(
        np.hypot(*(np.array(halfway_out(plane)) - [plane.x_rad.mean(), plane.y_rad.mean()])), radius / 2
    )


# ---------------------------------------------------------------- which observations


def test_examples_are_nearest_the_quartiles_and_trusted(setup):
    b2 = [1.0, 2.0, 4.0, 9.0, 16.0, 32.0, 64.0, 128.0, 256.0, np.nan, 4.0, 64.0]
    flags = ["", "", "poor fit", *[""] * 9]
    scenes = ["small"] * 10 + ["other"] * 2
    # Quartiles of all are 4 and 64. One 4 is flagged, one another scene's: in the logarithm 2 is nearer than 9.
    good, poor = weather_examples(survey(setup, b2, flags, scenes))
    assert (good.item.observation, poor.item.observation) == (1, 6)
    assert (good.weather, poor.weather) == ("good", "poor") and poor.b2 == 64.0
    with pytest.raises(ValueError, match="found 1 observations with a trusted wind and a fit; two"):
        weather_examples(survey(setup, b2[1:3], flags[1:3]))


# ---------------------------------------------------------------- figures 10 and 12


def test_streams_before_and_after_cleaning(setup, measured):
    figure = timestream_figure(measured)
    assert figure.number == 10 and len(figure.panels) == 4
    good, poor = weather_examples(measured)
    for one, panel, part in zip((good, poor), figure.panels[:2], figure.panels[2:], strict=True):
        assert part.series == panel.series and part.y_range[1] < panel.y_range[1]
        scans = one.streams.data_mk.reshape(setup.camera.n_det, 4, N).astype(float)
        flat = (scans - scans.mean(axis=-1, keepdims=True)).reshape(setup.camera.n_det, -1)
        raw = hann_psd(flat, 4, np.ones(4, bool), 10.0).mean(axis=0)[1:30]
        np.testing.assert_allclose(named(panel, "before cleaning").y, raw, rtol=1e-4)
        low = {name: named(panel, name).y[:3].sum() for name in ("before", "average", "planar", "quadratic")}
        assert low["before"] > 2 * low["average"] > 2 * low["planar"] > 2 * low["quadratic"]
        assert not np.array_equal(named(panel, "wind model").y, named(panel, "average").y)
        assert set(named(panel, "BLIP").y) == {2.5}
        ratio = low_ratio(named(panel, "quadratic").y, named(panel, "average").y)
        assert f"quadratic {ratio:.3g} in {one.weather} weather" in figure.caption


def low_ratio(first, second) -> float:
    """Power at the three frequencies up to 0.5 Hz of scans of 6 s."""
    return first[:3].sum() / second[:3].sum()


def test_beam_at_the_frequency_of_its_multipole(setup):
    """At 4 arcmin/s the beam of 1 arcmin has exp(-(2 pi f s)^2), s = 0.25 s / (8 ln 2)^(1/2)."""
    frequency = frequencies(setup)
    np.testing.assert_allclose(frequency, np.arange(1, 30) / 6)
    np.testing.assert_allclose(beam_power(setup), np.exp(-((2 * np.pi * frequency * 0.25) ** 2) / (8 * np.log(2))))


def test_a_sky_that_is_not_cleaned_has_the_transfer_function_one(measured):
    one = weather_examples(measured)[1]
    cost = cleaning_cost(one, "none")
    seen = beam_power(one.setup) > 0.1
    # Single precision of streams of 100 mK beside a sky of 0.02 mK: 1e-5 of the power, more where the beam leaves less.
    np.testing.assert_allclose(cost.transfer_function[seen], 1.0, atol=1e-2)
    assert cost.removed == 0
    average = cleaning_cost(one, "average")
    assert average.transfer_function[0] < 0.7 and average.removed == 1
    assert average.psd[0] < cost.psd[0]


def test_scans_in_which_the_sky_changes_the_modes_do_not_count(monkeypatch, measured):
    """A cleaning that halves all has the transfer function 1/4, whatever it does in a scan that it treats otherwise."""
    real, calls = cleaning_figures.clean, []

    def halving(name, data_mk, bounds, plane, *, options):
        if name == "none":
            return real(name, data_mk, bounds, plane, options=options)
        calls.append(name)
        removed, left = np.ones(4, int), 0.5 * real("none", data_mk, bounds, plane, options=options).data_mk
        if len(calls) == 2:
            removed[2] = 2
            left[:, 2 * N : 3 * N] += 1e3 * np.sin(np.arange(N))
        return Cleaned(left, np.ones(4, bool), np.ones((4, len(left))), np.zeros(4, int), removed)

    monkeypatch.setattr(cleaning_figures, "clean", halving)
    one = weather_examples(measured)[0]
    cost = cleaning_cost(one, "pca")
    np.testing.assert_allclose(cost.transfer_function[beam_power(one.setup) > 0.1], 0.25, atol=2e-3)
    assert cost.removed == 1


def test_ratio_of_transfer_function_and_noise_on_one_scale(setup, measured):
    figure = pca_figure(measured)
    seen, scales = beam_power(setup) > 0.1, []
    for one, panel in zip(weather_examples(measured), figure.panels, strict=True):
        for name, label in (("average", "average"), ("pca", "adaptive PCA")):
            cost, ratio = cleaning_cost(one, name), named(panel, f"{label}: S/N")
            np.testing.assert_array_equal(named(panel, f"{label}: PSD").y, cost.psd)
            np.testing.assert_array_equal(ratio.x, frequencies(setup)[seen])
            scales.append(ratio.y / (cost.transfer_function / cost.psd)[seen])
            if name == "pca":
                assert f"it takes {cost.removed:.1f} modes a scan" in figure.caption
    np.testing.assert_allclose(np.concatenate(scales), scales[0][0])


def test_template_figure_says_its_ratios(measured):
    figure = template_figure(measured)
    good, poor = ([series.y[:3].sum() for series in panel.series] for panel in figure.panels)
    assert [series.label for series in figure.panels[0].series] == ["1", "$x$", "$y$", "$xy$", "$x^2$", "$y^2$"]
    lowest, highest = (f"{value / good[0]:.2g}" for value in (min(good[1:]), max(good[1:])))
    assert f"{lowest} to {highest} (in amplitude" in figure.caption
    assert f"and by {np.sqrt(poor[0] / good[0]):.1f} in the zeroth" in figure.caption


def test_an_observation_without_a_scan_left_is_refused(measured):
    one = weather_examples(measured)[0]
    broken = replace(one, streams=replace(one.streams, data_mk=np.full_like(one.streams.data_mk, np.nan)))
    with pytest.raises(ValueError, match="found no scan of observation .* kept by average"):
        broken.clean("average")


# ---------------------------------------------------------------- figure 13


@pytest.fixture(scope="module")
def result(path) -> SurveyResult:
    setup = prepare(load_scene(path, {"cleaning.compare": ["planar"]}))
    return survey_result(setup, run_observations(setup, None), wall_s=1.0, workers=1)


def with_merits(result, target, values) -> SurveyResult:
    """The result with figures of merit (n_obs, 2) of average and planar."""
    places = [row_names(result.setup.analysis).index(f"merit_{target}_{name}") for name in ("actual", "planar")]
    rows = np.array(result.coadds.rows)
    rows[:, places] = values
    return replace(result, coadds=replace(result.coadds, rows=[tuple(row) for row in rows]))


def test_winners_are_counted(result):
    changed = with_merits(result, "cmb", [[3.0, 1.0], [1.0, 2.0], [0.5, 0.1], [0.0, 0.0]])
    found = winners(changed, "cmb", ("actual", "planar"))
    assert found == {"actual": pytest.approx(2 / 3), "planar": pytest.approx(1 / 3)}
    changed = with_merits(result, "point_source", [[1.0, 2.0]] * 3 + [[np.nan, 1.0]])
    assert winners(changed, "point_source", ("actual", "planar")) == {"actual": 0.0, "planar": 1.0}
    with pytest.raises(ValueError, match="found no merit_cmb_pca in the rows"):
        winners(result, "cmb", ("actual", "pca"))
    with pytest.raises(ValueError, match="found no observation with a figure of merit"):
        winners(with_merits(result, "cmb", np.zeros((4, 2))), "cmb", ("actual", "planar"))


def test_bins_of_one_unit_of_ln_ell_add_up_to_the_score(result):
    rings, item = result.setup.analysis.region.rings, result.scores["planar"]
    width = np.diff(rings.edges_ell) / rings.ell
    information = width / log_bin_sigma(result, item) ** 2
    np.testing.assert_allclose(information[result.setup.analysis.region.selected].sum() ** -0.5, item.band.sigma_ukcmb2)


def test_map_figure_draws_the_scores(result):
    figure = map_psd_figure(result)
    assert pipeline_names(result) == {"average": "actual", "planar": "planar", "optimal": "optimal"}
    noise, sensitivity, cumulative, ratio = figure.panels
    score, edges = result.setup.scene.score, result.setup.analysis.region.rings.edges_ell
    for label, name in pipeline_names(result).items():
        item = result.scores[name]
        np.testing.assert_allclose(named(noise, label).y, item.noise_psd[1:] * 3437.7468**2)
        np.testing.assert_array_equal(named(sensitivity, label).y, log_bin_sigma(result, item)[1:])
        line = named(cumulative, label)
        np.testing.assert_array_equal(line.x, edges[1:-1])
        np.testing.assert_allclose(line.y[line.x == score.ell_min], item.band.sigma_ukcmb2)
        all_from = [rescore(result.setup.analysis, one, 6000.0) for one in (item, result.scores["actual"])]
        expected = gain(*all_from)
        place = np.flatnonzero(line.x == 6000)[0]
        np.testing.assert_allclose(named(ratio, label).y[place], expected.ratio)
        band = ratio.series[ratio.series.index(named(ratio, label)) - 1]
        np.testing.assert_allclose(band.high[place] - band.y[place], expected.error, atol=1e-12)
    best = winners(result, "cmb", ("actual", "planar"))
    assert f"average {100 * best['actual']:.1f} (paper 50)" in figure.caption
    assert f"{100 * result.flux_removed['planar']:.1f} (paper 6)" in figure.caption


def test_a_result_that_compares_nothing_is_refused(result, path):
    with pytest.raises(ValueError, match="too few scans"):
        map_psd_figure(replace(result, scores={}, unscored="too few scans"))
    alone = replace(result, setup=prepare(load_scene(path)))
    with pytest.raises(ValueError, match=r"cleaning\.compare is empty"):
        map_psd_figure(alone)
