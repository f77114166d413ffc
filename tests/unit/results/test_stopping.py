"""Runs that end early: by their target or their time, the same bits however they got there, and said so."""

import json
from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits
from astropy.table import Table

from surveysim import load_scene, run
from surveysim.reduction.setup import prepare
from surveysim.report.figures.run_time import time_figure
from surveysim.report.terminal.survey import cost_lines, stop_lines, survey_lines
from surveysim.results.stopping import (
    FEWEST,
    UNLIMITED,
    StoppingCriteria,
    is_boundary,
    parsed_limits,
    stop_reason,
)
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.numbers import plain, quoted
from tests.scenes import SMALL_SCENE, WHITE_NOISE_SCENE, write_scene
from tests.unit.cli.test_cli import refused

TARGET = 0.5  # which 32 observations of the small scene reach


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path, SMALL_SCENE.replace("observations = 4", "observations = 40", 1))


@pytest.fixture(scope="module")
def forty(tmp_path_factory):
    """The same scene for runs that tests share."""
    path = tmp_path_factory.mktemp("forty") / "small.toml"
    path.write_text(SMALL_SCENE.replace("observations = 4", "observations = 40", 1))
    return load_scene(path)


@pytest.fixture(scope="module")
def part(forty):
    return run(forty, engine=SERIAL, target_error=TARGET)


@pytest.fixture(scope="module")
def whole(forty):
    return run(forty, engine=SERIAL)


def same_sums(one, other):
    for name in ("rows", "raw_psd", "clean_psd", "sums", "weight", "hits", "flipped", "signal_maps", "signal_weight"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize(
    "texts, found",
    [
        (("3%", "60s"), (0.03, 60.0)),
        (("0.03", "2 min"), (0.03, 120.0)),
        (("3 %", None), (0.03, None)),
        ((None, "0.5 h"), (None, 1800.0)),
        ((None, None), (None, None)),
    ],
)
def test_limits_of_texts(texts, found):
    limits = parsed_limits(*texts)
    assert (limits.target_error, limits.time_budget_s) == pytest.approx(found)


@pytest.mark.parametrize(
    "options, words",
    [
        (("--target-error", "3"), "target error: found 3; more than 0 and less than 100 % is expected"),
        (("--target-error", "0"), "target error: found 0"),
        (("--target-error=-3%",), "target error: found -0.03"),
        (("--target-error", "nan"), "--target-error: found 'nan'; a finite number"),
        (("--target-error", "3 mK"), "--target-error: found '3 mK'; a number or a percentage is expected"),
        (("--time-budget", "60"), "--time-budget: found '60'; a quantity in units like 's'"),
        (("--time-budget", "0 s"), "time budget: found 0 s; more than 0 s is expected"),
        (("--time-budget", "soon"), "--time-budget: found 'soon'"),
    ],
)
def test_limits_that_make_no_sense(call, scene, options, words):  # noqa: F811
    assert words in refused(call, scene, *options)


def test_a_target_needs_a_score(call, scene, tmp_path):  # noqa: F811
    scene.write_text(WHITE_NOISE_SCENE)
    assert "--target-error: found no [score]" in refused(call, scene, "--target-error", "3%")
    with pytest.raises(ValueError, match="score: missing"):
        run(load_scene(scene), target_error=0.03)
    with pytest.raises(ValueError, match="target error: found 3"):
        run(load_scene(scene), target_error=3.0)


def test_sweeps_have_no_time_budget(call, scene):  # noqa: F811
    scene.write_text(scene.read_text() + '\n[sweep]\n"scan.speed" = ["4 arcmin / s", "6 arcmin / s"]\n')
    words = "--time-budget: found a sweep, whose points run to the end of a round"
    assert words in refused(call, scene, "--time-budget", "1 s")


def test_boundaries_are_even_and_no_further_apart_than_an_eighth():
    found = [number for number in range(20_000) if is_boundary(number)]
    assert found[:3] == [FEWEST, FEWEST + 8, FEWEST + 16] and not any(number % 8 for number in found)
    steps = np.diff(found)
    assert (steps <= np.maximum(8, np.array(found[:-1]) / 8)).all() and (steps >= np.array(found[:-1]) / 32).all()


def test_which_reason_came_first(scene):
    good, bad = 0.02, 0.09
    setup = prepare(load_scene(scene))
    both = StoppingCriteria(0.03, 1.0)
    assert stop_reason(setup, both, 32, good) == "target" and stop_reason(setup, both, 32, bad) == "budget"
    assert stop_reason(setup, both, 34, good) == "budget" == stop_reason(setup, both, 2, None)
    assert stop_reason(setup, both, 40, good) == "all" == stop_reason(setup, UNLIMITED, 40, None)


def test_a_reached_target_ends_a_run_alike_whatever_the_workers(scene, part, tmp_path, two_threads):
    """Streams that workers wrote ahead of it are dropped."""
    options = {"engine": Engine(workers=2), "figures": False, "save_timestreams": True}
    crew = run(load_scene(scene), tmp_path / "out", target_error=TARGET, **options)
    assert part.stopped == crew.stopped == "target" and part.coadds.done == FEWEST
    assert part.estimate.relative_error <= TARGET
    same_sums(part.coadds, crew.coadds)
    assert part.estimate == crew.estimate
    names = sorted(path.name for path in (tmp_path / "out" / "timestreams").iterdir())
    assert names == [f"{number:04d}.h5" for number in range(FEWEST)]


def test_a_part_is_scored_for_the_whole_survey(scene, part):
    """The first 32 of 40 observations: sigma of a survey of 32 times 32 / 40, errors alike."""
    alone = run(load_scene(scene, {"observations": 32}), engine=SERIAL)
    # The observations with signal simulations of the small scenes are the same, so all else is.
    same_sums(part.coadds, alone.coadds)
    for name, item in part.scores.items():
        other = alone.scores[name]
        assert item.plain_band.sigma_ukcmb2 == pytest.approx(other.plain_band.sigma_ukcmb2 * 32 / 40, rel=1e-12)
        # Expectations over weather are those of 40 or of 32 observations, each known to 0.1 %.
        assert item.band.sigma_ukcmb2 == pytest.approx(other.band.sigma_ukcmb2 * 32 / 40, rel=4e-3)
        for key, rel in (("noise", 1e-9), ("transfer_function", 1e-9), ("weather", 4e-3)):
            assert vars(item.budget)[key] == pytest.approx(vars(other.budget)[key], rel=rel)
    ratio, other = (result.gains["actual / uncorrelated"].ratio for result in (part, alone))
    assert ratio == pytest.approx(other, rel=4e-3)


def test_a_run_goes_on_from_its_target(scene, whole, tmp_path):
    checked, out = load_scene(scene), tmp_path / "out"
    options = {"engine": SERIAL, "figures": False, "save_timestreams": True}
    first = run(checked, out, target_error=TARGET, **options)
    assert (out / "checkpoint.h5").exists()
    assert run(checked, out, resume=True, target_error=TARGET, **options).coadds.done == first.coadds.done
    assert len(list((out / "timestreams").iterdir())) == FEWEST
    assert run(checked, out, resume=True, target_error=0.9 * TARGET, **options).coadds.done >= first.coadds.done
    last = run(checked, out, resume=True, target_error=1e-4, **options)
    assert last.stopped == "all"
    assert len(list((out / "timestreams").iterdir())) == 40
    same_sums(last.coadds, whole.coadds)
    assert last.estimate == whole.estimate


def test_a_spent_budget_ends_a_run_after_a_pair(call, scene, tmp_path):  # noqa: F811
    out = tmp_path / "out"
    arguments = ("--out", out, "--workers", 1, "--no-figures")
    code, text, _ = call("run", scene, *arguments, "--time-budget", "1 ms", "--target-error", "1e-3 %")
    assert code == 0 and "the time budget was spent, 2 of 40 observations simulated" in text
    summary = json.loads((out / "summary.json").read_text())
    assert summary["stopped"]["reason"] == "budget" and summary["observations"] == 2
    assert summary["stopped"]["observations_of_survey"] == 40 and summary["stopped"]["time_budget_s"] == 1e-3
    assert fits.getheader(out / "maps" / "actual.fits")["NOBS"] == 2
    # It goes on without limits; tables say what they are of.
    meta = Table.read(out / "tables" / "scores.ecsv").meta
    assert (meta["observations_simulated"], meta["observations_of_survey"]) == (2, 40)
    code, text, _ = call("run", scene, *arguments, "--resume")
    assert code == 0 and "Stopped" not in text


def test_a_budget_needs_no_score(scene):
    scene.write_text(WHITE_NOISE_SCENE)
    result = run(load_scene(scene), engine=SERIAL, time_budget_s=1e-3)
    assert (result.stopped, result.coadds.done, result.estimate) == ("budget", 2, None)
    assert stop_lines(result) == ["Stopped: the time budget was spent, 2 of 4 observations simulated"]


def test_the_cost_of_a_fine_answer_is_what_its_errors_add_up_to(forty, whole):
    result = whole
    item, cost, score = result.scores["actual"], result.fine_cost, forty.score
    budget = item.budget
    # Of the noise's error, (1 - c) / K goes with the K flips and c with observations, c their share in common.
    weights = item.weights[item.weights > 0]
    common = np.sum(weights**2) / weights.sum() ** 2
    signs = budget.noise**2 / (1 + score.jackknives * common / (1 - common))
    of_observations = (budget.noise**2 - signs + budget.weather**2) * 40 / cost.observations
    fixed = (
        signs * score.jackknives / cost.jackknives + budget.transfer_function**2 * score.signal_sims.skies / cost.skies
    )
    # Observations come in pairs.
    assert fixed + of_observations + budget.population**2 == pytest.approx(1e-4, rel=4 / cost.observations)
    assert cost.seconds == pytest.approx(cost.observations * sum(result.coadds.seconds.values()) / 40)
    needed = f"{cost.observations} observations, {cost.jackknives} sign-flipped co-adds (score.jackknives)"
    assert needed in cost_lines(result)[0]
    twice = replace(result, workers=2)
    assert twice.fine_cost.seconds == pytest.approx(cost.seconds / 2)


def test_the_figure_of_error_against_time_goes_through_the_run_and_its_costs(whole):
    result = replace(whole, workers=2)
    alone, more, own = time_figure(result).panels[0].series
    seconds, error = own.x[0], own.y[0]
    assert seconds == pytest.approx(sum(result.coadds.seconds.values()) / 2)
    assert error == result.estimate.relative_error
    at = np.exp(np.interp(np.log(seconds), np.log(alone.x), np.log(alone.y)))
    assert at == pytest.approx(error, rel=0.01)
    # Without more flips the error stays above theirs; with them it falls on.
    assert alone.y[-1] > np.hypot(result.parts.flips, result.parts.skies) and more.y.min() < 0.5 * alone.y.min()
    for time, target in zip(more.x, more.y, strict=True):
        assert result.cost(target).seconds == time


def test_lines_of_a_part(part):
    result = part
    lines = list(survey_lines(result))
    band, drawn = result.scores["actual"].band, result.scores["actual"].plain_band
    assert lines[0] == "  of the whole survey of 40 observations, judged by 32"
    assert "forecast for all weather" in lines[1] and lines[1].endswith(
        f"Plain (actual): {plain(quoted(drawn.sigma_ukcmb2, drawn.error_ukcmb2))}"
    )
    assert result.estimate.sigma_ukcmb2 == band.sigma_ukcmb2 != drawn.sigma_ukcmb2
    assert "the target error was reached, 32 of 40" in stop_lines(result)[0]
