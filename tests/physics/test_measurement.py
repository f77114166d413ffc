"""Measurements of an observation: variances of known noise, and the weather that was put in."""

import math

import numpy as np
import pytest

from mapmaker.cleaning import TemplateOptions, clean
from mapmaker.stream_psd import low_frequency_variance
from surveysim.paper.measured_survey import measure_survey
from surveysim.paper.measurement import map_variances, raw_variance
from surveysim.paper.recovery import recovery_table
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.simulation import observation_path
from tests.scenes import WHITE_NOISE_SCENE, write_scene

ARCMIN = math.radians(1 / 60)
LYNX = "scenarios/lynx.toml"


def test_low_frequency_variance_of_one_sine_and_of_a_constant():
    time = np.arange(100) / 10
    sine = 3 * np.sin(2 * np.pi * 0.7 * time)
    data = np.stack([np.concatenate([sine, np.full(100, 5.0)]), np.zeros(200)])
    # 4.5 in the first scan, nothing in the second.
    np.testing.assert_allclose(low_frequency_variance(data, 2, 10.0, 1.0), [2.25, 0], atol=1e-12)
    np.testing.assert_allclose(low_frequency_variance(data, 2, 10.0, 0.6), [0, 0], atol=1e-12)


def test_white_noise_leaves_no_raw_variance_and_no_residual_in_the_map(tmp_path):
    """PSD 2.5 mK^2/Hz at 10 Hz; n degrees of freedom know a variance to sqrt(2 / n)."""
    path = tmp_path / "white.toml"
    path.write_text(WHITE_NOISE_SCENE)
    setup = prepare(load_scene(path, {"scan.scans": 20, "scan.duration": "15 s"}))
    streams = draw_observation(setup, 0)
    n_low = 2 * 15 * 20 * setup.camera.n_det  # sines and cosines below 1 Hz
    assert raw_variance(setup, streams) == pytest.approx(0, abs=4 * 2.5 * math.sqrt(2 / n_low + 2 / (2.4 * n_low)))


def test_map_of_white_noise_is_white(tmp_path):
    """A common signal for the templates, far above; what cleaning leaves is white."""
    path = write_scene(tmp_path)
    changes = {"scan.scans": 16, "scan.step": "0.5 arcmin", "instrument.responsivity_scatter": 0.0}
    setup = prepare(load_scene(path, changes))
    streams = draw_observation(setup, 0)
    rng = np.random.default_rng(3)
    common = np.repeat(np.cumsum(rng.standard_normal(streams.data_mk.shape[1]))[None], setup.camera.n_det, axis=0)
    noise = rng.standard_normal(streams.data_mk.shape)
    streams.data_mk[:] = 30 * common + 5 * noise
    options = TemplateOptions(1e-8, 100)
    cleaned = clean("average", streams.data_mk, streams.scan_bounds, streams.focal_plane, options=options)
    variance, white = map_variances(setup, streams, observation_path(setup.observing, 0)[1], cleaned)
    # A few hundred pixels under the taper, of which an eighth of the modes are the highest.
    assert variance == pytest.approx(white, rel=0.25)
    pixel, detectors = (30 / 60) ** 2, streams.data_mk.shape[1] * setup.camera.n_det
    covered = 24 * (7.5 + 2.7)  # arcmin^2: scans of 24 arcmin, 16 steps and the camera
    assert white == pytest.approx(25 * covered / pixel / detectors, rel=0.5)


@pytest.fixture(scope="module")
def survey():
    """Measurements of two surveys of other seeds."""
    scenes = [load_scene(LYNX, {"observations": 160} | seed) for seed in ({}, {"seed": 1})]
    return measure_survey(scenes, SERIAL)


@pytest.mark.slow
def test_weather_comes_back(survey):
    """Errors of medians and spreads of n observations by bootstrap, two of them beside each bound."""
    rows = {row["quantity"]: (row["ours"], row["error"]) for row in recovery_table(survey)}

    def within(quantity, target, bound):
        value, error = rows[quantity]
        assert abs(value - target) < bound + 2 * error, quantity

    within("wind speed, median relative error", 0, 0.02)
    assert rows["wind speed, relative scatter (68 %)"][0] < 0.10
    within("wind direction, 68 % within", 0, 5)
    within("median wind, measured where trusted", 31, 0.05 * 31)
    # 18 scans share trends: the median of so skew a distribution lies 10 % below its mean.
    within("B2 over the drawn one, median", 0.90, 0.03)
    within("index b, median", 11 / 3, 0.01)
    assert 0.4 < rows["share of winds trusted"][0] < 0.8
    # Heights are not told: none of nine has a quarter of the observations.
    assert rows["largest share of one of nine heights"][0] < 0.25


@pytest.mark.slow
def test_quartiles_of_b2_come_back(survey):
    """Quartiles of fits against quartiles of the drawn B2 with the errors of fits: 10 % low, a scatter of 0.44.

    The drawn values about a quartile decide how far errors move it. The expectation and its error are therefore from
    many draws of the errors for the same B2. The closed form has no errors of the wind; 0.05 allows for them.
    """
    used = np.isfinite(survey.b2_fitted)
    fitted, drawn = np.log(survey.b2_fitted[used]), np.log(survey.b2_drawn[used])
    errors = np.random.default_rng(3).normal(math.log(0.90), 0.44, (1000, drawn.size))
    expected = np.percentile(drawn + errors, [25, 50, 75], axis=1)
    off = np.percentile(fitted, [25, 50, 75]) - expected.mean(axis=1)
    np.testing.assert_array_less(np.abs(off), 0.05 + 2.5 * expected.std(axis=1))
    assert used.mean() > 0.98


@pytest.mark.slow
def test_fitted_b2_scatters_as_18_scans_that_share_trends(survey):
    """Relative scatter 0.44 in the closed form for one detector; errors of the wind add a little."""
    ratio = survey.b2_fitted / survey.b2_drawn
    known = np.isfinite(ratio) & survey.wind_known & (survey.b2_drawn > 100)
    inner = np.percentile(ratio[known], [5, 95])
    assert np.log(inner[1] / inner[0]) == pytest.approx(2 * 1.645 * 0.44, rel=0.2)


@pytest.mark.slow
def test_raw_variance_is_the_model_s(survey):
    """B2 sin(el)^-8/3 of the closed form for each wind; the ratio's median to the scatter of 18 scans."""
    from surveysim.atmosphere.thin_screen import Screen, at_elevation, mean_removed_variance

    layer = Screen(11 / 3, 8e-3)
    ratio = []
    for item in survey.measurements:
        sine = np.sin(item.elevation_rad)
        model = item.layer_b2 * np.mean(sine ** (-8 / 3))
        model *= mean_removed_variance(at_elevation(layer, sine.mean()), item.truth.wind_speed_rad_s, 15.0)
        if item.layer_b2 > 200:  # where nothing but the atmosphere counts
            ratio.append(item.raw_mk2 / model)
    # The median of 18 scans that share trends lies 10 % below the mean.
    assert np.median(ratio) == pytest.approx(0.90, abs=0.03 + 2 * 1.25 * np.std(ratio) / math.sqrt(len(ratio)))
