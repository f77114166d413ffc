"""Extreme values of all keys: a scene that `check` accepts can be run, and any other is refused at once."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from surveysim.reduction import resource_limits as limits
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare, signal_sim_observations
from surveysim.runtime import memory
from surveysim.runtime.errors import SceneError
from surveysim.scene.keys import all_keys
from surveysim.scene.scene import load_scene
from surveysim.studies.resources import _windiest
from surveysim.survey.coadds import add_observations, empty_coadds, observation_sums
from surveysim.telescope.scans import samples_per_scan
from tests.extremes_of_keys import bounds, extreme_overrides, is_number
from tests.scenes import write_scene

FIRST_LIGHT = Path(__file__).parents[3] / "scenarios" / "first_light.toml"
MOST_SECONDS, MOST_BYTES = 10.0, 3e9
MOST_WORK = 3e7  # detector-samples of an observation that a test makes
EACH = 14  # of the extremes of keys that is tried; with 1, which takes a quarter of an hour, all are


@pytest.fixture
def small(tmp_path):
    return write_scene(tmp_path)


def refused_or_run(path, overrides) -> str:
    """The text of a refusal by check, or nothing once an observation, the windiest, has been simulated and added."""
    start = perf_counter()
    try:
        scene = load_scene(path, {"observations": 4} | overrides)
        setup = prepare(scene)
    except SceneError as error:
        assert perf_counter() - start < MOST_SECONDS
        return str(error)
    assert perf_counter() - start < MOST_SECONDS
    skies, lmax = setup.analysis.n_signal_skies, scene.sky.curved_lmax if scene.sky else None
    if (
        setup.camera.n_det * scene.scan.scans * samples_per_scan(setup.observing.scans) * max(1, skies / 10) > MOST_WORK
        or (lmax or 0) > 5000
    ):
        return ""
    result = observe(setup, _windiest(setup), bool(signal_sim_observations(scene).any()))
    assert np.isfinite(result.sums).all()
    add_observations(
        setup.analysis, empty_coadds(setup.analysis), [observation_sums(setup.analysis, replace(result, observation=0))]
    )
    return ""


def test_every_number_has_both_bounds():
    """In the schema, from which the guide's tables are made."""
    for key, item in all_keys().items():
        if key.startswith("optimise."):
            continue  # values of any key, which that key bounds
        if is_number(item) or "unit" in item:
            least, most = bounds(item)
            assert least is not None and most is not None and least < most, key
        elif item["type"] == "array" and item["items"].get("type") in ("integer", "number"):
            assert None not in bounds(item["items"]), key


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"atmosphere.wind_median": "300 deg / s"}, "atmosphere: found a strip of the layer with"),
        ({"atmosphere.layer_height": "90000 km"}, "atmosphere: found a strip of the layer with"),
        ({"atmosphere.illuminated_aperture": "1 mm"}, "atmosphere: found a strip of the layer with"),
        ({"atmosphere.wind_b2_exponent": -2}, ""),
        ({"atmosphere.b2": "[0, 280, 980] mK2 rad(-5/3)", "atmosphere.wind_b2_exponent": -2}, ""),
        ({"atmosphere.b2_probabilities": [0.49, 0.5, 0.51], "atmosphere.b2": "[1e-9, 1, 1e9] mK2 rad(-5/3)"}, "B2 = "),
        ({"fixed_pointing.elevation": "5 deg"}, ""),
        ({"score.ell_bin": 1}, "score.ell_bin: no Fourier mode of the map has"),
        (
            {"score.ell_min": 7000, "score.ell_bin": 4000, "score.ell_max": 11_000},
            "score.ell_bin: found 4000; a bin within ell_min to ell_max is expected",
        ),
        ({"instrument.beam_fwhm": "2 deg", "score": None}, ""),
        ({"instrument.beam_fwhm": "2 deg"}, "score.ell_min: found 4000; multipoles that the beam lets through"),
        ({"score.taper_fraction": 0}, ""),
        ({"score.jackknives": 2, "score.signal_sims.skies": 2}, ""),
        ({"numerics.max_block_memory": "1 byte"}, ""),
    ],
    ids=range(14),
)
def test_check_and_run_agree(small, overrides, words):
    text = refused_or_run(small, overrides)
    assert words in text and bool(words) == bool(text) and "\n" not in text


def test_weather_of_many_observations_is_bounded(small):
    """Nobody draws that of a million to check them: it is as extreme as hardly any of such surveys has it."""
    keys = {"observations": 500_000, "atmosphere.wind_log_scatter": 1}
    start = perf_counter()
    with pytest.raises(SceneError, match="atmosphere: found a strip of the layer .* in wind of .* arcmin / s"):
        prepare(load_scene(small, keys))
    assert prepare(load_scene(small, {"observations": 500_000})).scene.observations == 500_000
    assert perf_counter() - start < MOST_SECONDS


def test_the_fastest_wind_is_faster_than_all_that_are_drawn(small):
    from surveysim.atmosphere.weather import fastest_wind
    from surveysim.timestreams.observed_block import observation_weather

    setup = prepare(load_scene(small, {"observations": 300, "atmosphere.wind_b2_exponent": 0.3}))
    drawn = max(observation_weather(setup, number).wind_speed_rad_s for number in range(300))
    bound = fastest_wind(setup.scene.atmosphere, None, 300)
    assert drawn < bound < 100 * drawn
    assert limits._drawn_wind(setup.scene.atmosphere, setup.air.water, setup.scene.seed, 300, dated=None) == drawn


@pytest.mark.parametrize(
    ("overrides", "key"),
    [
        ({"score.signal_sims.skies": 1000, "scan.step": "1 deg"}, "score.signal_sims.skies"),
        ({"scan.step": "5 deg"}, "map.pixel"),
        ({"scan.step": "1 deg", "score.size": "3 deg", "map.pixel": "3 arcsec", "sky": None}, "score.size"),
        ({"scan.scans": 100_000, "scan.step": "0 deg", "scan.duration": "60 s"}, "scan.sample_rate"),
    ],
)  # fmt: skip
def test_scenes_larger_than_the_machine_are_refused_before_they_are_made(small, monkeypatch, overrides, key):
    """By their key, with what they take; it is not taken."""
    monkeypatch.setattr(limits, "machine_bytes", lambda: 1e9)
    before = memory.peak_bytes()
    with pytest.raises(SceneError, match="found a scene that needs about .* GB of memory in one process") as caught:
        prepare(load_scene(small, overrides))
    assert str(caught.value).startswith(f"{key}: ")
    assert memory.peak_bytes() - before < 3e8


def test_skies_are_not_made_to_be_checked(small):
    setup = prepare(load_scene(small, {"score.signal_sims.skies": 1000, "seed": 12}))
    assert not {"signal_skies_mk", "region"} & vars(setup.analysis).keys()
    assert "map_mk" not in vars(setup.sky) and setup.analysis.n_signal_skies == 1001  # with the scene's own


@pytest.mark.slow
@pytest.mark.parametrize(("key", "overrides"), [*extreme_overrides(2)][::EACH], ids=lambda item: str(item)[:60])
def test_check_and_run_agree_at_extremes_of_all_keys(monkeypatch, key, overrides):
    monkeypatch.setattr(limits, "machine_bytes", lambda: MOST_BYTES)
    lines = refused_or_run(FIRST_LIGHT, overrides).splitlines()
    others_missing = [line for line in lines if line.endswith("missing; this key is expected")]  # of its section
    assert all(": " in line and len(line) < 700 for line in lines) and len(lines) <= max(1, len(others_missing)), lines
