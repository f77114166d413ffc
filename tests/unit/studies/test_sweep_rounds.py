"""Sweeps with a target error: rounds, decisions, the same bits whatever the workers and interruptions, and words."""

import json

import numpy as np
import pytest
from astropy.table import Table

from surveysim import load_sweep, run_sweep
from surveysim.output.lock import OutputError
from surveysim.report.terminal.sweep import print_sweep
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import InputError
from surveysim.studies.sweep import rounds
from surveysim.studies.sweep.comparison import compare, run_stages
from surveysim.studies.sweep.point_run import Stage
from surveysim.studies.sweep.rounds import SweepLimits, decision, round_ends
from surveysim.survey import run as survey
from tests.pages import read_page
from tests.unit.studies.test_sweep_run import WHITE

# The second point is close to the first, the third is far worse.
SPEEDS = '\n[sweep]\n"scan.speed" = ["4 arcmin / s", "4.1 arcmin / s", "12 arcmin / s"]\n'
LIMITS = {"target_error": 1e-4, "confidence": 0.9}


@pytest.fixture
def path(write):
    scene = (
        WHITE.replace("observations = 4\n", "observations = 16\n", 1)
        .replace("jackknives = 4", "jackknives = 32")
        .replace("skies = 2", "skies = 8")
    )
    return write(scene + SPEEDS)


@pytest.fixture
def early(monkeypatch):
    """Rounds end at 4, 8 and 16 observations."""
    monkeypatch.setattr(rounds, "FEWEST", 4)
    monkeypatch.setattr(rounds, "may_end", lambda scene, end: True)


def test_rounds_double(write, monkeypatch):
    """From 32 on, where there is enough simulated signal, up to the largest survey."""
    few = WHITE.replace("observations = 4\n", "observations = 400\n", 1)
    points = load_sweep(write(few + "\n[sweep]\nobservations = [40, 400]\n")).points
    assert round_ends(points) == (32, 64, 128, 256, 400)
    monkeypatch.setattr(rounds, "may_end", lambda scene, end: end >= 50)
    assert round_ends(points) == (64, 128, 256, 400)
    assert round_ends(load_sweep(write(WHITE + '\n[sweep]\n"scan.scans" = [4]\n')).points) == (4,)


# ---------------------------------------------------------------- decisions


def compared(sigma, own):
    modes = np.column_stack([np.full(len(sigma), 0.3), own * np.eye(len(sigma))])
    return compare(np.array(sigma), modes, np.random.default_rng(1))


def test_the_best_point_is_known():
    """Two standard deviations of a difference apart, sqrt(2) 0.01: a probability of 0.977."""
    found = compared([1.0, np.exp(0.0283)], 0.01)
    assert decision(found, SweepLimits(0.001, 0.95), looks=1, flips=1000) == ("confidence", (0,))
    assert decision(found, SweepLimits(0.001, 0.95), looks=4, flips=1000) == ("", (0, 1))
    # With 5 sign flips, Student's t of 4 degrees of freedom is 2.13 at 0.95.
    assert decision(found, SweepLimits(0.001, 0.95), looks=1, flips=5) == ("", (0, 1))


def test_equal_points_reach_the_target():
    found = compared([1.0, 1.0, 2.0], 0.001)
    assert decision(found, SweepLimits(0.0015), looks=3, flips=100) == ("target", (0, 1))
    assert decision(found, SweepLimits(0.0014), looks=3, flips=100) == ("", (0, 1))


def test_all_go_on_while_none_competes():
    found = compare(np.array([1.0, 1.0]), np.full((2, 1), np.nan), np.random.default_rng(1))
    assert decision(found, SweepLimits(0.1), looks=3, flips=100) == ("", (0, 1))


@pytest.mark.parametrize("limits", [(0.0, 0.9), (1.0, 0.9), (0.1, 0.4), (0.1, 1.0)])
def test_limits_that_make_no_sense(limits):
    with pytest.raises(InputError, match="(target error|confidence): found .* is expected"):
        SweepLimits(*limits)


# ---------------------------------------------------------------- sweeps


def test_observations_go_where_the_ranking_is_open(early, path, tmp_path, capsys):
    result = run_sweep(path, tmp_path / "out", engine=SERIAL, figures=False, **LIMITS)
    assert [point.observations for point in result.points] == [16, 16, 4]
    assert result.rounds.ends == (4, 8, 16) and result.rounds.reason == "all"
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["stopped"] == {"reason": "all", **LIMITS, "rounds": [4, 8, 16]}
    table = Table.read(tmp_path / "out" / "sweep.ecsv", format="ascii.ecsv")
    assert list(table["observations"]) == [16, 16, 4]
    said = (
        "The sweep ended after 3 rounds, to 16 observations, 36 in all: the points that may be the best have all their"
    )
    assert said in read_page(tmp_path / "out" / "report.html").one("header").text
    print_sweep(result, tmp_path / "out")
    assert said in capsys.readouterr().out.replace("\n", " ")
    point = json.loads((tmp_path / "out" / "points" / "2" / "summary.json").read_text())
    assert point["observations"] == 4 and point["stopped"]["reason"] == "sweep"
    assert "the sweep needed no more observations" in (tmp_path / "out" / "points" / "2" / "report.html").read_text()


def test_a_point_that_stopped_has_the_bits_of_its_first_observations(early, path):
    """A point of two rounds, and one that runs to their end at once."""
    sweep = load_sweep(path)
    point = run_sweep(sweep, engine=SERIAL, **LIMITS | {"confidence": 0.5}).points
    assert [item.observations for item in point] != [16, 16, 16]
    stages = [Stage(sweep.points[number], item.observations) for number, item in enumerate(point)]
    alone = run_stages(sweep, stages, None, SERIAL, resume=False, progress=lambda done: None)
    for one, other in zip(point, alone, strict=True):
        np.testing.assert_array_equal(one.scores["actual"].noise_psds, other.scores["actual"].noise_psds)
        assert one.scores["actual"].band.sigma_ukcmb2 == other.scores["actual"].band.sigma_ukcmb2


@pytest.mark.slow
def test_workers_and_interruptions_change_no_bit(early, path, tmp_path, monkeypatch, two_threads):
    """Interrupted in the second round, and in the first; files of the rounds go with the end of the sweep."""
    one, two, three = (tmp_path / name for name in ("one", "two", "three"))
    run_sweep(path, one, engine=SERIAL, figures=False, **LIMITS)
    run_sweep(path, two, engine=Engine(workers=2), figures=False, **LIMITS)
    for last in (6, 11):  # 12 observations in the first round
        observe, calls = survey.observe, []

        def stop(*arguments, observe=observe, calls=calls, last=last, **options):
            calls.append(arguments)
            if len(calls) == last:
                raise KeyboardInterrupt
            return observe(*arguments, **options)

        with monkeypatch.context() as patch:
            patch.setattr(survey, "observe", stop)
            with pytest.raises(KeyboardInterrupt):
                run_sweep(path, three, engine=SERIAL, resume=last > 6, figures=False, **LIMITS)
    names = {item.name for item in (three / "points").iterdir()}
    assert {"000_0004.npz", "001_0004.npz", "002_0004.npz", "001.checkpoint.h5"} <= names
    with pytest.raises(OutputError, match="with other settings"):
        run_sweep(path, three, engine=SERIAL, resume=True, figures=False, target_error=0.5)
    run_sweep(path, three, engine=SERIAL, resume=True, figures=False, **LIMITS)
    tables = [(folder / "sweep.ecsv").read_bytes() for folder in (one, two, three)]
    assert tables[0] == tables[1] == tables[2]
    assert sorted(item.name for item in (three / "points").iterdir()) == ["0", "1", "2"]
