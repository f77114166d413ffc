"""Figures 3 to 9 and 16 of the paper from records made by hand: what is counted and drawn is known beforehand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mapmaker.correlations import Profile
from surveysim.atmosphere.turbulence_fit import HEIGHT_GRID_M, INDEX_GRID, KOLMOGOROV, fitted_profile
from surveysim.atmosphere.weather import Weather
from surveysim.paper.figures import wind as wind_figures
from surveysim.paper.figures.noise import b2_distribution_figure, b2_water_figure, map_variance_figure
from surveysim.paper.figures.scores import data_set_psd_figure, gain_table, sensitivity_table
from surveysim.paper.figures.turbulence import (
    adjacent_profile,
    correlation_figure,
    index_height_figure,
    typical_observations,
    without_overlap,
)
from surveysim.paper.figures.wind import typical_observation, wind_examples_figure, wind_histogram_figure
from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.measurement import camera_pairs
from surveysim.paper.statistics import (
    binned,
    bootstrap,
    centile_errors,
    cumulative,
    described,
    median_error,
    quarters,
    scale_to,
)
from surveysim.reduction.setup import prepare
from surveysim.results.results import survey_result
from surveysim.scene.passband import top_hat
from surveysim.scene.scene import load_scene
from surveysim.survey.run import run_observations
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SMALL_SCENE
from tests.surveys import ARCMIN, N_SCAN, falls, fit, measured, named, of_b2, survey, wind


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.toml"
    path.write_text(SMALL_SCENE, encoding="utf-8")
    return prepare(load_scene(path).model_copy(update={"score": None}))


# ---------------------------------------------------------------- statistics


def test_bins_hold_equal_numbers_and_their_centiles():
    """120 values make 8 bins of 15; of 0 to 14 the centiles are 1.4, 3.5, 7, 10.5 and 12.6."""
    x = np.random.default_rng(1).permutation(120)
    found = binned(x, 100.0 + x)
    np.testing.assert_array_equal(found.count, 15)
    np.testing.assert_allclose(found.x, 7.0 + 15.0 * np.arange(8))
    first = np.array([1.4, 3.5, 7.0, 10.5, 12.6])
    np.testing.assert_allclose(found.centile, 100.0 + first[:, None] + 15.0 * np.arange(8))
    np.testing.assert_array_equal(found.median, found.centile[2])
    assert binned(np.arange(29.0), np.arange(29.0)).count.tolist() == [29]
    assert len(binned(np.arange(1000.0), np.arange(1000.0)).x) == 8


def test_errors_are_those_of_the_normal_distribution():
    """400 resamples give a standard deviation to 3.5 %; that of a median depends on the sample too, n^(-1/4)."""
    values = np.random.default_rng(2).normal(5.0, 3.0, 2500)
    value, error = bootstrap(values, np.mean)
    assert value == values.mean()
    np.testing.assert_allclose(error, values.std() / 50.0, rtol=0.14)
    np.testing.assert_allclose(centile_errors(values, (50.0,))[0], 1.2533 * 3.0 / 50.0, rtol=0.4)
    assert bootstrap(values, np.mean) == (value, error)
    assert bootstrap(np.full(9, 4.0), np.median) == (4.0, 0.0)
    np.testing.assert_array_equal(centile_errors(np.arange(40.0), (25.0, 50.0)).shape, (2,))


@pytest.mark.parametrize("call", [lambda x: bootstrap(x, np.mean), lambda x: centile_errors(x, (50.0,)), cumulative])
def test_no_value_is_refused(call):
    with pytest.raises(ValueError, match="found no observation; at least one"):
        call(np.array([]))


def test_cumulative_and_scale():
    x, share = cumulative(np.array([3.0, 1.0, 2.0, 10.0]))
    np.testing.assert_array_equal(x, [1.0, 2.0, 3.0, 10.0])
    np.testing.assert_allclose(share, [0.125, 0.375, 0.625, 0.875])
    # 2 and 8 times the model: 4 in the logarithms; what is not positive does not count.
    np.testing.assert_allclose(scale_to(np.array([2.0, 80.0, -3.0, 0.0]), np.array([1.0, 10.0, 1.0, 1.0])), 4.0)
    assert np.isnan(scale_to(np.array([-1.0]), np.array([1.0])))


def test_quarters_and_medians_of_what_is_known():
    values = np.array([4.0, np.nan, 1.0, 3.0, 2.0])
    parts = quarters(values)
    np.testing.assert_array_equal([np.flatnonzero(part) for part in parts], [[2], [4], [3], [0]])
    with pytest.raises(ValueError, match="found 3 observations with a fit; 4 or more"):
        quarters(values[1:])
    assert median_error(values)[0] == 2.5 and median_error(values)[1] > 0
    assert np.isnan(median_error(np.full(3, np.nan))).all()


def test_a_survey_is_described(setup):
    items = [measured(setup)] * 3
    whole = survey(setup, items, tuple(fit(1.0) for _ in items), ["lynx", "lynx", "sds1"])
    assert described(whole) == "3 simulated observations at 143 GHz (2 of lynx, 1 of sds1)"


# ---------------------------------------------------------------- figures 3 and 4


def test_the_typical_observation_is_of_median_goodness_in_poor_weather(setup):
    goodness = [9.0, 3.0, 1.0, 2.0, 0.5, 0.7, 2.0]
    flags = ["", "", "", "poor fit", "", "", ""]
    items = [measured(setup, k, found=wind(30.0, f, g)) for k, (f, g) in enumerate(zip(flags, goodness, strict=True))]
    # Above the median of 5: the first three and one that is flagged; the last two are another scene's.
    fits = tuple(fit(b2) for b2 in (7.0, 8.0, 9.0, 6.0, 1.0, 5.0, 4.0))
    whole = survey(setup, items, fits, ["small"] * 5 + ["other"] * 2)
    assert typical_observation(whole) == 1
    alone = survey(setup, items[4:5], fits[4:5])
    assert typical_observation(alone) == 0
    with pytest.raises(ValueError, match="found no wind to be trusted in scene 'small'"):
        typical_observation(survey(setup, items[3:4], fits[3:4]))


def test_slopes_are_of_the_wind_in_seconds_an_arcminute(setup, monkeypatch):
    monkeypatch.setattr(wind_figures, "two_layers", lambda *_: wind(90.0, "more than one layer"))
    figure = wind_examples_figure(survey(setup, [measured(setup)], (fit(280.0),)))
    left, right = figure.panels
    for panel, speed in ((left, 30.0), (right, 90.0)):
        data, line = named(panel, "measured"), named(panel, "fitted")
        np.testing.assert_allclose(data.y, 2 * np.pi / speed * np.cos(np.radians(data.x)))
        np.testing.assert_allclose(data.high - data.y, 0.05 * np.abs(data.y).max())
        np.testing.assert_allclose(line.y, 2 * np.pi / speed * np.cos(np.radians(line.x)), atol=1e-12)
    assert "trusted" in left.title and "more than one layer" in right.title
    assert "measured 30.0 ± 3.0 arcmin/s" in figure.caption and "measured 90.0 ± 9.0" in figure.caption
    assert "0 of 1 winds" in figure.caption


def test_the_second_layer_is_seen_with_the_responsivities(setup, monkeypatch):
    seen = {}

    def layer(_, observation, pointing, weather, data, realization):
        seen.update(weather=weather, realization=realization, start=pointing.start_mjd)
        data += 7.0

    truth = Weather(280.0, 1.0, 0.3, np.nan)
    streams = SimpleNamespace(data_mk=np.ones((setup.camera.n_det, 5), np.float32))
    monkeypatch.setattr(wind_figures, "draw_observation", lambda *_: streams)
    monkeypatch.setattr(wind_figures, "observation_weather", lambda *_: truth)
    monkeypatch.setattr(wind_figures, "add_layers", layer)
    monkeypatch.setattr(wind_figures, "replace", lambda record, **new: SimpleNamespace(**{**vars(record), **new}))
    monkeypatch.setattr(wind_figures, "measure", lambda _, data, number: SimpleNamespace(wind=(data.data_mk, number)))
    data, number = wind_figures.two_layers(setup, 1)
    np.testing.assert_allclose(data, np.tile(1.0 + 7.0 * setup.camera.responsivity[:, None], 5), rtol=1e-6)
    assert (
        number == 1 and seen["realization"] == 1 and seen["start"] == observation_path(setup.observing, 1)[1].start_mjd
    )
    assert seen["weather"].b2 == 280.0 and seen["weather"].wind_speed_rad_s == 1.0
    np.testing.assert_allclose(seen["weather"].wind_angle_rad, 0.3 + np.radians(120.0))


def test_winds_are_counted_where_trusted_beside_all_that_were_drawn(setup):
    found = [wind(12.0), wind(13.0), wind(31.0), wind(40.5), wind(2.0, "poor fit")]
    drawn = [10.5, 13.0, 31.0, 44.0, 47.0]
    items = [measured(setup, found=f, drawn_wind=d) for f, d in zip(found, drawn, strict=True)]
    figure = wind_histogram_figure([survey(setup, items, tuple(fit(1.0) for _ in items))])
    (panel,) = figure.panels
    trusted, every = named(panel, "measured"), named(panel, "drawn")
    np.testing.assert_array_equal(trusted.x, np.arange(0.0, 51.0, 5.0))
    np.testing.assert_allclose(trusted.y[:-1], [0, 0, 0.5, 0, 0, 0, 0.25, 0, 0.25, 0])
    np.testing.assert_allclose(every.y[:-1], [0, 0, 0.4, 0, 0, 0, 0.2, 0, 0.2, 0.2])
    assert trusted.label == "measured and trusted (4): median 22.0 (paper 31)"
    assert every.label == "drawn (5): median 31.0"
    assert "1 winds are not to be trusted" in figure.caption
    with pytest.raises(ValueError, match="no wind to be trusted at 143 GHz"):
        wind_histogram_figure([survey(setup, items[4:], (fit(1.0),))])


# ---------------------------------------------------------------- figures 5 and 6


def profile_of(whole: MeasuredSurvey, point, amplitude: float, level: float = np.log(50.0)) -> Profile:
    """Theory at a grid point with `amplitude` of overlap, jackknife errors of the profile growing with the bin."""
    theory = (
        np.log(whole.grid.correlation(np.full(N_SCAN, 0.1), np.full(N_SCAN, 1.0)))[point] + amplitude * whole.overlap
    )
    logs = theory - theory.mean()
    error = 1e-4 * (1 + np.arange(len(logs)))
    scans = logs + error / np.sqrt(N_SCAN - 1) * np.array([1, -1, 1, -1])[:, None]
    return Profile(np.full(len(logs), 50.0), 51.0, logs, scans, level)


@pytest.fixture(scope="module")
def profiled(setup):
    point = (KOLMOGOROV, 3)
    empty = survey(setup, [measured(setup)], (fit(280.0),))
    items = [measured(setup, k, profile=profile_of(empty, point, 0.03)) for k in range(2)]
    return survey(setup, items, (fit(100.0, point), fit(900.0, point)))


def test_fitted_profile_takes_offset_and_overlap(profiled):
    profile, theory = profiled.measurements[0].profile, np.log(profiled.theory(0))
    fitted, error = fitted_profile(profile, theory, profiled.overlap)
    np.testing.assert_allclose(fitted[KOLMOGOROV, 3], profile.log_profile, atol=1e-12)
    np.testing.assert_allclose(error, 1e-4 * (1 + np.arange(len(error))))
    assert np.abs(fitted[0, 0] - profile.log_profile).max() > 1e-5
    # Without overlap an offset is all that is fitted: the weighted mean of what is left is 0.
    fitted, _ = fitted_profile(profile, theory[0, 0], None)
    np.testing.assert_allclose(np.ptp(fitted - theory[0, 0]), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.average(profile.log_profile - fitted, weights=error**-2.0), 0.0, atol=1e-12)


def test_correlations_are_shown_without_overlap_on_the_scale_of_their_level(profiled):
    theta = profiled.bins.theta_rad / ARCMIN
    zenith = theta / np.sin(1.0)
    bare = without_overlap(profiled, 0).log_profile + falls(np.array([11 / 3]), np.array([1000.0]))[0] * zenith**2
    np.testing.assert_allclose(np.ptp(bare), 0.0, atol=1e-8)
    figure = correlation_figure(profiled)
    assert figure.columns == 2 and len(figure.panels) == 4
    left, right = figure.panels[:2]
    for panel in (left, right):
        data, best = named(panel, "measured"), named(panel, "(best)")
        np.testing.assert_allclose(data.x, theta)
        np.testing.assert_allclose(data.y, best.y, atol=1e-9)
        np.testing.assert_allclose(
            best.y[0] - best.y,
            50.0 * falls(*np.array([[11 / 3], [1000]]))[0, 0] * (zenith**2 - zenith[0] ** 2),
            rtol=1e-5,
        )
        np.testing.assert_allclose(data.high - data.y, 50.0 * 1e-4 * (1 + np.arange(len(theta))))
    # Families fall as their theory does, in the order of the grid.
    labels = [series.label for series in left.series if series.kind == "line"]
    assert labels == ["b = 2.67", "b = 3.17", "b = 3.67 (best)", "b = 4.17", "b = 4.67"]
    drop = [np.ptp(series.y) for series in left.series if series.kind == "line"]
    np.testing.assert_allclose(np.array(drop) / drop[2], (8.0 - (8 / 3 + 0.5 * np.arange(5))) / (8.0 - 11 / 3))
    labels = [series.label for series in right.series if series.kind == "line"]
    assert labels == ["h = 375 m", "h = 1000 m (best)", "h = 2000 m", "h = 6000 m"]
    assert len({series.look for series in left.series}) == len(left.series)
    assert "adjacent pairs" in [series.label for series in left.series]
    assert "adjacent pairs" not in [series.label for series in right.series]


def test_adjacent_pairs_are_free_of_gains(setup):
    bins, rng = camera_pairs(setup), np.random.default_rng(3)
    gains = np.exp(0.05 * rng.standard_normal(setup.camera.n_det))
    shape = np.append(1e-3 * np.arange(len(bins.count)), 0.0)  # the last for adjacent pairs, of bin -1
    shape -= shape[:-1].mean()
    excess = 0.01 * np.array([1.0, 2.0, 4.0, 3.0])
    covariances = np.zeros((N_SCAN, setup.camera.n_det, setup.camera.n_det))
    for scan, above in zip(covariances, excess, strict=True):
        shape[-1] = above
        scan[bins.first, bins.second] = 300.0 * gains[bins.first] * gains[bins.second] * np.exp(shape[bins.bin])
    value, error = adjacent_profile(covariances, bins)
    np.testing.assert_allclose(value, np.log(np.mean(np.exp(excess))), atol=1e-10)
    left_out = [np.log(np.mean(np.exp(np.delete(excess, k)))) for k in range(N_SCAN)]
    np.testing.assert_allclose(error, np.std(left_out) * np.sqrt(N_SCAN - 1))


def test_examples_are_of_typical_chi2_on_either_side_of_the_median(setup):
    """Quartiles of ln B2 lie at B2 of 57 and 152; a fourth of ten observations on either side are two."""
    b2, chi2 = 10.0 * np.arange(1, 21), np.full(20, 10.0)
    chi2[[5, 14]] = 1.0  # the nearest, 60 and 150, are of untypical chi^2
    items = [measured(setup, k) for k in range(20)]
    fits = tuple(fit(b, chi2=c) for b, c in zip(b2, chi2, strict=True))
    assert typical_observations(survey(setup, items, fits)) == (4, 15)
    flagged = list(items)
    flagged[4] = measured(setup, 4, found=wind(30.0, "poor fit"))
    assert typical_observations(survey(setup, flagged, fits)) == (6, 15)
    unfitted = (*fits[:15], None, *fits[16:])
    assert typical_observations(survey(setup, items, unfitted))[1] != 15
    # Where the first scene has none on a side, the nearest of the other.
    assert typical_observations(survey(setup, items, fits, ["small"] * 2 + ["other"] * 18)) == (1, 1)
    with pytest.raises(ValueError, match="found no observation with a wind to be trusted and a fit"):
        typical_observations(survey(setup, flagged[4:5], fits[4:5]))


def test_best_fits_are_counted(setup):
    best = [(6, 3), (6, 0), (7, 8), (5, 3)]
    items = [measured(setup, k) for k in range(5)]
    figure = index_height_figure(survey(setup, items, (*(fit(1.0, point) for point in best), None)))
    index, height = figure.panels
    steps = named(index, "best fits")
    expected = np.zeros(13)
    expected[[5, 6, 7]] = 1, 2, 1
    np.testing.assert_array_equal(steps.y[:-1], expected)
    np.testing.assert_allclose((steps.x[1:] + steps.x[:-1]) / 2, INDEX_GRID)
    assert "3.67 ± 0.35 (paper 3.3 ± 1.1)" in steps.label  # 0.5 / sqrt(2)
    np.testing.assert_allclose(named(index, "11/3").x, 11 / 3)
    steps = named(height, "best fits")
    np.testing.assert_array_equal(steps.y[:-1], [1, 0, 0, 2, 0, 0, 0, 0, 1])
    edges = steps.x
    assert (edges[:-1] < HEIGHT_GRID_M).all() and (edges[1:] > HEIGHT_GRID_M).all()
    np.testing.assert_allclose(named(height, "uniform").y, 4 / 9)
    # chi^2 of 1, 2 and 1 among 9: sum n^2 / u - N = 6 / (4/9) - 4.
    assert "chi^2 = 9.5 for 8" in figure.caption and "1 left out for want of a fit" in figure.caption
    with pytest.raises(ValueError, match="found no observation with a fit"):
        index_height_figure(survey(setup, items[:1], (None,)))


# ---------------------------------------------------------------- figures 7, 8 and 9


def test_distribution_of_b2_and_the_papers_quartiles(setup):
    whole = of_b2(setup, np.array([400.0, 100.0, np.nan, 200.0]))
    figure = b2_distribution_figure([whole])
    (panel,) = figure.panels
    fitted, drawn, paper = (named(panel, what) for what in ("fitted", "drawn", "paper"))
    np.testing.assert_array_equal(fitted.x, [100.0, 200.0, 400.0])
    np.testing.assert_allclose(fitted.y, [1 / 6, 1 / 2, 5 / 6])
    np.testing.assert_array_equal(drawn.x, [1.0, 100.0, 200.0, 400.0])
    np.testing.assert_array_equal(paper.x, [100.0, 280.0, 980.0])
    np.testing.assert_allclose(paper.y, [0.25, 0.5, 0.75])
    calibration = next(series for series in panel.series if not series.label)
    np.testing.assert_allclose(calibration.x.reshape(3, 3)[:, :2], np.outer([100.0, 280.0, 980.0], [0.88, 1.12]))
    np.testing.assert_allclose(calibration.y.reshape(3, 3)[:, 0], [0.25, 0.5, 0.75])
    assert np.isnan(calibration.x[2::3]).all()
    assert "quartiles 150, 200 and 300 fitted" in figure.caption


def test_b2_against_water_follows_the_response_that_it_is_made_of(setup):
    water = replace(setup, air=replace(setup.air, water=SimpleNamespace(response=lambda pwv: 100.0 * pwv**2)))
    pwv = np.linspace(0.5, 3.5, 121)
    whole = of_b2(water, 0.25 * 100.0 * pwv**2, pwv=pwv)
    figure = b2_water_figure([whole, whole])
    assert len(figure.panels) == 2
    panel = figure.panels[0]
    median, line, wide = (named(panel, what) for what in ("median", "scaled", "10th"))
    assert len(median.x) == 8
    np.testing.assert_allclose(median.y, 25.0 * median.x**2, rtol=1e-2)  # bins of even number have medians of means
    np.testing.assert_allclose(line.y, 25.0 * line.x**2, rtol=1e-2)
    assert (wide.low < median.y).all() and (median.y < wide.high).all() and (median.low < median.y).all()
    assert "2.50e-01 rad^(-5/3) times" in figure.caption
    with pytest.raises(ValueError, match="found no site at 143 GHz"):
        b2_water_figure([of_b2(setup, np.array([1.0]))])


def test_residual_variance_of_maps_in_cmb_temperature(setup):
    b2 = np.arange(1.0, 121.0)
    whole = of_b2(setup, b2, left=0.3 * b2)
    figure = map_variance_figure(whole)
    top, bottom = figure.panels
    scale = top_hat(143e9, 0.0).cmb_per_rj ** 2
    median, line, inner = (named(top, what) for what in ("median", "proportional", "25th"))
    np.testing.assert_allclose(median.x, 8.0 + 15.0 * np.arange(8))
    np.testing.assert_allclose(median.y, 0.3 * scale * median.x)
    np.testing.assert_allclose(line.y, 0.3 * scale * line.x)
    np.testing.assert_allclose(inner.high - inner.low, 0.3 * scale * 7.0)
    np.testing.assert_allclose(bottom.series[0].x, 0.3 * scale * b2)
    np.testing.assert_allclose(bottom.series[0].y, (np.arange(120) + 0.5) / 120)
    assert f"level is {2 * scale:.2g} mK_CMB^2 (paper about 5)" in figure.caption
    assert "grows by 14.1 while B2 grows by 14" in figure.caption  # 113 / 8


def test_maps_without_a_fit_are_left_out_of_the_bins_alone(setup):
    b2 = np.append(np.arange(1.0, 31.0), np.nan)
    figure = map_variance_figure(of_b2(setup, b2, left=np.ones(31)))
    top, bottom = figure.panels
    assert len(named(top, "median").x) == 2 and len(bottom.series[0].x) == 31


# ---------------------------------------------------------------- figure 16 and Table 3


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    path = tmp_path_factory.mktemp("scored") / "small.toml"
    path.write_text(SMALL_SCENE, encoding="utf-8")
    scored = prepare(load_scene(path))
    return survey_result(scored, run_observations(scored, None), wall_s=1.0, workers=1)


def test_noise_of_data_sets_is_an_amplitude_of_all_detectors(result):
    figure = data_set_psd_figure(result)
    (panel,) = figure.panels
    used = result.setup.analysis.region.rings.edges_ell[:-1] >= 500
    to_arcmin2 = np.degrees(60.0) ** 2
    masked = next(name for name in result.scores if name.startswith("masked"))
    share = result.scores[masked].n_det / result.setup.camera.n_det
    for name, label, factor in (("actual", "actual", 1.0), ("white", "white", 1.0), (masked, "masked", share)):
        line = next(series for series in panel.series if series.kind == "line" and label in series.label)
        np.testing.assert_allclose(line.y**2, factor * to_arcmin2 * result.scores[name].noise_psd[used])
        np.testing.assert_array_equal(line.x, result.setup.analysis.region.rings.ell[used])
    bands = [series for series in panel.series if series.kind == "band"]
    assert len(bands) == 4 and all((band.low < band.high).all() for band in bands)
    own = result.scores["actual"]
    flat = named(panel, "flat CMB")
    np.testing.assert_allclose(flat.y**2, own.band.sigma_ukcmb2 * own.signal_psd[used] * to_arcmin2)
    gain = result.gains["actual / uncorrelated"]
    assert f"actual / uncorrelated {gain.ratio:.2f} ± {gain.error:.2f}" in figure.caption


@pytest.mark.parametrize("make", [data_set_psd_figure, sensitivity_table, gain_table])
def test_a_run_without_scores_is_refused(result, make):
    with pytest.raises(ValueError, match="found no scores: too few; a scored run is expected"):
        make(replace(result, scores={}, unscored="too few"))
