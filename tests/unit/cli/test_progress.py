"""Estimates of the time left: none before they can be made, and never of a few seconds when minutes are left."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from surveysim import load_scene
from surveysim.cli.progress import (
    SIGNAL_SIM_WORK,
    START_S,
    TimeLeft,
    announce_compilation,
    equal_work,
    finish_times,
    observation_work,
    progress_display,
    score_so_far,
    seconds_left,
    time_text,
)
from surveysim.reduction.setup import prepare
from surveysim.results.control_variate import quoted_scores
from surveysim.survey.run import run_observations
from tests.scenes import write_scene


class Clock:
    """A clock that is set by hand."""

    def __init__(self):
        self.seconds = 0.0

    def __call__(self):
        return self.seconds


def estimates(work, workers, arrivals, first=1):
    """Estimates when the items come in at these times, those before the `first` being kept from an earlier run."""
    clock = Clock()
    left, found = TimeLeft(work, workers, clock), []
    for done, clock.seconds in enumerate(arrivals, start=first):
        found.append(left.add(done))
    return found


def test_items_that_free_workers_take_in_turn():
    np.testing.assert_allclose(finish_times(np.array([1, 1, 1, 1, 1]), 2), [1, 1, 2, 2, 3])
    # The second worker is free after 1, 3 and 5; results come in order.
    np.testing.assert_allclose(finish_times(np.array([4, 1, 2, 2]), 2), [4, 4, 4, 5])
    np.testing.assert_allclose(finish_times(np.array([3, 1]), 1), [3, 4])


def test_two_points_that_come_in_together():
    """Three points of a minute with two workers: a whole minute is left when the second comes in right after the first,
    where the rate between the two alone would say nothing is.
    """
    assert estimates(equal_work(3), 2, [60.0, 60.01, 120.0]) == [60.0, 60.01, None]


def test_points_of_different_work():
    """One worker, 10 s for a unit of work, 5 s of start-up: exact once a second point is in."""
    arrivals = 5 + 10 * np.cumsum([2, 1, 4, 3])
    found = estimates([2, 1, 4, 3], 1, arrivals)
    assert found[0] == pytest.approx(25 / 2 * 8) and found[1:] == [70, 30, None]


def test_little_work_after_much_does_not_tell():
    """A point of a hundredth of the work of the one before it: the time since the start counts."""
    assert estimates([100, 1, 100], 1, [100.0, 105.0, 205.0])[1] == pytest.approx(105 / 101 * 100)


def test_start_up_is_no_estimate():
    """Observations within the time of start-up and compilation give no estimate; the second observation does."""
    found = estimates(equal_work(100), 1, [START_S - 1, START_S - 0.9])
    assert found[0] is None and found[1] == pytest.approx(0.1 * 98)


def test_slow_first_observation_is_no_estimate():
    """Kernels compile for 60 s in both of two workers: the time left follows from what observations say they took."""
    clock = Clock()
    left = TimeLeft(equal_work(12), 2, clock)
    clock.seconds = 61.5
    assert left.add(1, 7.5) == 7.5
    clock.seconds = 63.0
    assert left.add(4, 6.0) == 6.0


def test_the_time_left_of_a_run_is_steady(tmp_path):
    """Two observations carry signal simulations; workers finish them in any order, and the others eight at once."""
    work = observation_work(load_scene(write_scene(tmp_path), {"observations": 36}))
    assert work.tolist() == [SIGNAL_SIM_WORK] * 2 + [1] * 34
    finished = np.array([2, 4, 12, 20, 36])
    sums = [SimpleNamespace(finished=n, seconds=3 * work[:n].sum()) for n in finished]
    found = [seconds_left(item, work, 2) for item in sums]
    np.testing.assert_allclose(found, [3 / 2 * work[n:].sum() for n in finished])
    assert seconds_left(SimpleNamespace(finished=0, seconds=0.0), work, 2) is None


@pytest.mark.parametrize("cached", [False, True])
def test_compilation_is_announced(capsys, monkeypatch, cached):
    monkeypatch.setattr("mapmaker.kernels.compiled.is_cached", lambda kernel: cached)
    announce_compilation("lynx")
    said = "lynx: compiling kernels before the first result, up to a minute; later runs load them\n"
    assert capsys.readouterr().err == ("" if cached else said)


def test_items_of_an_earlier_run_take_no_time():
    """Resumed with 7 of 10 done: the eighth comes in after 60 s, so two minutes are left for two."""
    assert estimates(equal_work(10), 1, [60.0, 120.0, 180.0], first=8) == [120, 60, None]


def test_an_estimate_counts_down_and_is_dropped_when_it_was_too_short():
    clock = Clock()
    left = TimeLeft(equal_work(2), 1, clock)
    assert left.now() is None
    clock.seconds = 60.0
    assert left.add(1) == 60.0
    clock.seconds = 90.0
    assert left.now() == 30.0
    clock.seconds = 121.0
    assert left.now() is None


@pytest.mark.parametrize(
    "seconds, text", [(0.4, "0 s left"), (119, "119 s left"), (120, "2 min left"), (9000, "2 h left")]
)
def test_times_as_text(seconds, text):
    assert time_text(seconds) == text


def test_lines_off_a_terminal(capsys, monkeypatch):
    """Two workers, six points of 60 s in three pairs. Of the last, which is under way, nothing is known: not "0 s"."""
    clock = Clock()
    monkeypatch.setattr("surveysim.cli.progress.TimeLeft.__init__.__defaults__", (clock,))
    with progress_display("six", equal_work(6), False, "points", 2) as show:
        for done, clock.seconds in enumerate([60, 60, 120, 120, 180, 180], start=1):
            show(done, lambda: "")
    lines = [line.removeprefix("six: ") for line in capsys.readouterr().err.splitlines()]
    assert lines == [
        "1/6 points, 2 min left",
        "2/6 points, 2 min left",
        "3/6 points, 60 s left",
        "4/6 points, 60 s left",
        "5/6 points",
        "6/6 points",
    ]


@pytest.mark.parametrize("n_obs, known", [(4, True), (3, False)])
def test_the_score_so_far_is_the_one_that_is_quoted(tmp_path, n_obs, known):
    path = write_scene(tmp_path)
    scene = load_scene(path, {"observations": n_obs})
    setup = prepare(scene)
    shown = []
    coadds = run_observations(setup, None, progress=shown.append)
    item = quoted_scores(setup, coadds)["actual"]
    assert item.control is not None and np.isfinite(item.band.error_ukcmb2) == known
    text = score_so_far(setup, shown[-1])
    if not known:
        assert text == ""
        return
    found = re.fullmatch(r"sigma\(A\) = (\d+) \+- (\w+) uK_CMB\^2", text)  # without an exponent
    assert found, text
    assert float(found[1]) == pytest.approx(item.band.sigma_ukcmb2, abs=0.06 * item.band.sigma_ukcmb2)
    assert float(found[2]) == pytest.approx(item.band.error_ukcmb2, rel=0.06)
