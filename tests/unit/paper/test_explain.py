"""Ingredients beyond one frozen layer: their settings, the findings as statistics, verdicts, and the whole command."""

import json
import shlex
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from astropy.table import Table

from mapmaker.timestreams import FocalPlane
from surveysim import load_scene
from surveysim.cli.options import settings
from surveysim.output.lock import OutputError
from surveysim.paper.explain import run
from surveysim.paper.explain.comparison import Finding, compared
from surveysim.paper.explain.findings import bootstrapped, findings, paper_slope
from surveysim.paper.explain.ingredients import Explained, Ingredient, explained, ingredients
from surveysim.paper.explain.second_layer import trusted_rows, winds
from surveysim.paper.explain.values import CLEANINGS, SETTINGS, signal_maps, template_ratios
from surveysim.reduction.cleaned_block import reduce_block
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL
from surveysim.scene.shipped import scene_folder
from surveysim.studies.budget.points import as_options
from surveysim.timestreams.observation import Stopwatch
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SMALL_SCENE, without_sections

# Streams that are nearly all atmosphere, so that short scans tell its wind.
SCENE = (
    without_sections(SMALL_SCENE, "excess", "sky")
    .replace("[100, 280, 980]", "[30000, 60000, 90000]")
    .replace('duration = "6 s"', 'duration = "12 s"')
)


def values(n_obs=64, exponent=0.6, **others):
    """Values of a survey whose raw noise is an exact power of B2."""
    b2 = np.geomspace(10, 1e4, n_obs)
    plain = {"observation": np.arange(n_obs), "drawn_b2": b2, "fitted_b2": b2, "raw_mk2": 3 * b2**exponent}
    return plain | others


def finding(name):
    return next(item for item in findings() if item.name == name)


# ---------------------------------------------------------------- findings


def test_exponent_of_raw_noise():
    assert finding("raw_exponent").statistic(values()) == pytest.approx(0.6, abs=1e-9)
    # Table 2 by hand: slope of ln(77, 131, 310, 1060) against ln(46, 170, 580, 4000).
    slope = np.polyfit(np.log([46, 170, 580, 4000]), np.log([77, 131, 310, 1060]), 1)[0]
    assert paper_slope()[0] == pytest.approx(slope) and 0.02 < paper_slope()[1] < 0.08


def test_winds_of_both_halves():
    wind = np.where(np.arange(64) < 48, "trusted", "more than one layer")
    told = {name: finding(f"winds_trusted{name}").statistic(values(wind=wind)) for name in ("", "_better", "_poorer")}
    assert told == {"": 75, "_better": 100, "_poorer": 50}


def test_best_cleaning():
    merits = {f"merit_cmb_{name}": np.full(64, float(place)) for place, name in enumerate(CLEANINGS)}
    merits["merit_cmb_average"] = np.where(np.arange(64) < 16, 9.0, 0.0)
    assert finding("pca_best").statistic(values(**merits)) == 75


def test_change_of_b2_with_the_height():
    b2 = values()["fitted_b2"]
    ends = {"lowest_layer_b2": 1.2 * b2, "highest_layer_b2": 0.9 * b2}
    assert finding("height_change").statistic(values(**ends)) == pytest.approx(15)


def test_template_ratios_of_known_templates():
    rng, n_samp = np.random.default_rng(5), 18 * 150
    x, y = rng.uniform(-1e-3, 1e-3, (2, 40))
    plane = FocalPlane(x, y, 3e-4)
    setup = SimpleNamespace(
        observing=SimpleNamespace(scans=SimpleNamespace(n_scans=18, sample_rate_hz=10.0, scan_s=15.0))
    )
    streams = SimpleNamespace(focal_plane=plane, scan_bounds=np.arange(0, n_samp + 1, 150)[:, None][:-1] + [0, 150])
    half = np.hypot(x - x.mean(), y - y.mean()).max() / 2 / np.sqrt(2)
    place = x.mean() + half, y.mean() + half
    terms = [x, y, x * y, x**2, y**2], [place[0], place[1], place[0] * place[1], place[0] ** 2, place[1] ** 2]
    data = np.ones((40, 1)) * rng.standard_normal(n_samp)
    for of_detectors, there in zip(*terms, strict=True):
        data += np.sqrt(0.2) * np.outer(of_detectors / there, rng.standard_normal(n_samp))
    cleaned = SimpleNamespace(kept=np.ones(18, bool), responsivity=np.ones((18, 40)))
    low, every = template_ratios(SimpleNamespace(data_mk=data, streams=streams, setup=setup), cleaned)
    # 18 scans, 74 frequencies: a logarithm of a mean over five templates and 18 scans scatters by 0.26 a frequency.
    assert every == pytest.approx(0.2, rel=0.26 / np.sqrt(74 / 2) * 4)
    assert low == pytest.approx(0.2, rel=0.26 / np.sqrt(7 / 2) * 4)


# ---------------------------------------------------------------- comparison


def number(paper, paper_error=np.nan):
    return Finding("mean", "mean", (paper, paper), paper_error, lambda item: float(item["raw_mk2"].mean()))


def test_differences_are_paired():
    noise = np.random.default_rng(2).standard_normal(64)
    one, same, moved = (values(raw_mk2=noise + shift) for shift in (0.0, 0.0, 1.0))
    first, second, third = compared(number(1.0), [one, same, moved])
    assert first.error == pytest.approx(noise.std() / 8, rel=0.15)  # 400 resampled surveys: 4 % scatter
    assert (second.difference, second.difference_error) == (0, 0)
    assert third.difference == pytest.approx(1) and third.difference_error < 1e-12


@pytest.mark.parametrize(
    "paper, error, shift, verdict",
    [
        (5.0, np.nan, 5.0, "explains"),
        (5.0, np.nan, 2.0, "helps"),
        (5.0, np.nan, -2.0, "worsens"),
        (5.0, np.nan, 0.3, ""),  # less than a tenth of the gap
        (0.0, np.nan, 2.0, "worsens"),
        (0.0, 2.0, 1.0, ""),  # both agree
        (5.0, 0.1, 4.5, "helps"),  # a fifth is no agreement where the error is known
    ],
)
def test_verdicts(paper, error, shift, verdict):
    noise = np.random.default_rng(3).standard_normal(64)
    noise -= noise.mean()
    surveys = [values(raw_mk2=noise), values(raw_mk2=noise + shift)]
    assert compared(number(paper, error), surveys)[1].verdict == verdict


def test_ranges_agree_within_their_ends():
    item = replace(number(0.0), paper=(1.0, 2.0))
    assert (item.gap(0.5), item.gap(1.5), item.gap(2.25)) == (0.5, 0, 0.25)
    assert np.isfinite(bootstrapped(item, values())).all()


# ---------------------------------------------------------------- ingredients


def test_settings_are_options_of_a_command():
    for item in ingredients():
        given = as_options(item.settings)
        words = [word for word in shlex.split(given) if word != "--set"]
        assert settings(words) == dict(item.settings), item.name


def test_every_ingredient_is_a_scene_of_its_own():
    asked = explained(scene_folder(), observations=9)
    assert len({scene.model_dump_json() for scene in asked.scenes}) == len(asked.scenes)
    assert {(scene.seed, scene.observations) for scene in asked.scenes} == {(asked.scenes[0].seed, 9)}
    assert asked.ingredients[0].settings == {} and all(item.origin for item in asked.ingredients)


# ---------------------------------------------------------------- observations


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scenes") / "small.toml"
    path.write_text(SCENE)
    return load_scene(path, SETTINGS | {"observations": 8})


def test_signal_maps_are_those_of_a_run(scene):
    """Of cleanings that remove the same number of modes from all scans."""
    setup = prepare(scene)
    _, pointing = observation_path(setup.observing, 0)
    part = reduce_block(setup, 0, pointing, setup.observing.blocks[0], delays_s_rad=None, watch=Stopwatch())
    patch = setup.analysis.region.patch
    mine = signal_maps(part, setup.analysis.signal_skies_mk[-1])[..., patch, patch]
    theirs = observe(setup, 0, with_signal_sims=True).signal_maps[-1]
    for place, name in enumerate(CLEANINGS[:3]):
        scale = np.abs(theirs[place, 0]).max()
        assert scale > 0
        np.testing.assert_allclose(mine[place], theirs[place], atol=1e-4 * scale, err_msg=name)


@pytest.mark.slow
def test_a_second_layer_costs_trusted_winds_in_poor_weather():
    """Of 12 winds in the poorer half 0.96 are trusted with one layer and none with 30 % at 120 degrees (guide)."""
    asked = explained(scene_folder(), observations=24)
    rows = trusted_rows({(120, share): winds(asked.layers[120, share], SERIAL) for share in (0.0, 0.3)})
    one, two = (row["poorer"] for row in rows)
    assert one >= 9 / 12  # binomial: less in 0.1 % of surveys
    assert two <= 2 / 12


@pytest.mark.slow
def test_whole_command(scene, tmp_path, monkeypatch):
    drift = {"responsivity_drift": {"rms": 0.1, "time_scale": "12 s"}}
    items = Ingredient("one_layer", "one layer", "", {}), Ingredient("drift", "drift", "assumed", drift)
    path = tmp_path / "small.toml"
    path.write_text(SCENE)
    second = load_scene(path, SETTINGS | {"observations": 8} | drift)
    asked = Explained(items, (scene, second), {(90.0, 0.0): scene})
    counted = []
    content = run.explain(asked, tmp_path / "out", SERIAL, progress=lambda: counted.append(1))
    assert len(counted) == asked.observations == 24
    names = {"explain.ecsv", "second_layer.ecsv", "second_layer.png", "report.html", "summary.json", ".surveysim.json"}
    assert {path.name for path in (tmp_path / "out").iterdir()} == names | {
        "observations_one_layer.ecsv",
        "observations_drift.ecsv",
    }
    table = Table.read(tmp_path / "out" / "explain.ecsv")
    assert len(table) == 2 * len(findings())
    assert json.loads((tmp_path / "out" / "summary.json").read_text())["explained"]["observations"] == 8
    monkeypatch.setattr(run, "survey_values", lambda *arguments: pytest.fail("simulated again"))
    again = run.explain(asked, tmp_path / "out", SERIAL)
    assert again["findings"] == content["findings"]
    with pytest.raises(OutputError, match="other settings"):
        run.explain(replace(asked, scenes=(scene, scene)), tmp_path / "out", SERIAL)
