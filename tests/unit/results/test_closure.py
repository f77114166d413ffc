"""Closure tests, input against output: known noise, weather drawn often, signal in closed form."""

import numpy as np
import pytest

from surveysim import load_scene
from surveysim.reduction.setup import prepare
from surveysim.results.closure import closure_tests
from surveysim.results.results import survey_result
from surveysim.survey.run import run_observations
from tests.scenes import SMALL_SCENE, without_sections
from tests.stopped import weather_scene

PLAIN = without_sections(SMALL_SCENE, "atmosphere", "excess", "sky").replace(
    'algorithm = "average"', 'algorithm = "none"'
)


def found(scene):
    setup = prepare(scene)
    coadds = run_observations(setup, None)
    result = survey_result(setup, coadds, wall_s=1.0, workers=1)
    return {item.quantity: item for item in closure_tests(setup, coadds, result.scores, result.expected)}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "scene.toml"


def test_white_noise_comes_back(path):
    """Photon and detector noise, nothing else, and nothing cleaned away but the mean: within 4 standard errors."""
    path.write_text(PLAIN)
    items = found(load_scene(path, {"observations": 40}))
    white = items["white noise of the streams, above 2.5 Hz"]
    assert white.expected == pytest.approx(5) and 0 < white.error < 0.05
    assert abs(white.found - white.expected) < 4 * white.error
    assert "B2, median" not in items


def test_noise_of_a_load_is_that_of_each_observation(path):
    text = without_sections(PLAIN, "photon", "detector").replace(
        "[map]", '[detector]\nnep = "3e-17 W / Hz(1/2)"\n[map]'
    )
    path.write_text(text)
    instrument = {"bandwidth": 0.15, "efficiency": 0.3, "polarizations": 2}
    scene = load_scene(path, {f"instrument.{key}": value for key, value in instrument.items()} | {"observations": 40})
    white = found(scene)["white noise of the streams, above 2.5 Hz"]
    assert abs(white.found / white.expected - 1) < 0.02


@pytest.mark.slow
def test_weather_is_that_of_its_distribution(tmp_path):
    items = found(weather_scene(tmp_path, {"observations": 150, "score.signal_sims.observations": 40}))
    for name, expected in (("first quartile", 500), ("median", 1000), ("third quartile", 2000)):
        item = items[f"B2, {name}"]
        assert item.expected == pytest.approx(expected) and item.unit == "mK2 rad(-5/3)" and item.kind == "drawn"
        assert abs(item.found - item.expected) < 4 * item.error < item.expected
    wind = items["wind, median"]
    assert wind.expected == pytest.approx(31) and abs(wind.found - 31) < 4 * wind.error
    assert not any(name.startswith("water") for name in items)  # of a site alone
    kept = items["signal power left by cleaning, actual"]
    assert 0 < kept.found <= 1.05 and abs(kept.found - kept.expected) < 0.1


def test_errors_of_quartiles_are_those_of_so_many_draws():
    """Standard error of the median of n normal deviates: sqrt(pi / 2 n); within 15 % on average over samples."""
    from surveysim.results.closure import _quartile

    draws = np.random.default_rng(1).standard_normal((200, 400)) + 10
    items = [_quartile("x", "", 1, 10.0, sample, 400) for sample in draws]
    expected = np.sqrt(np.pi / 2 / 400)
    assert np.mean([item.error for item in items]) == pytest.approx(expected, rel=0.15)
    assert np.std([item.found for item in items]) == pytest.approx(expected, rel=0.2)
