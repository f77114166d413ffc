"""Figures that are drawn by one process or by two."""

import os
import signal
from multiprocessing import active_children

import pytest

from surveysim.output import drawings
from surveysim.output.drawings import draw

NAMES = ("a", "b", "c", "d", "e")


def wrong(path):
    raise ValueError("no font")


def killed(path):
    if os.getpid() != PARENT:
        os.kill(os.getpid(), signal.SIGKILL)
    path.write_text("drawn again")


PARENT = os.getpid()


@pytest.fixture(params=[True, False], ids=["two", "one"])
def forks(request, monkeypatch):
    monkeypatch.setattr(drawings, "_may_fork", lambda: request.param)
    return request.param


def drawn(tmp_path, **other):
    by, files, warnings = {}, [], []

    def write(path):
        path.write_text(str(os.getpid()))

    draw(tmp_path, lambda: dict.fromkeys(NAMES, write) | other, files, warnings)
    for path in files:
        by[path.stem] = path.read_text()
    return by, warnings


def test_figures_are_drawn_by_two_processes_where_a_fork_is_safe(tmp_path, forks):
    by, warnings = drawn(tmp_path)
    assert sorted(by) == list(NAMES) and not warnings
    assert {by[name] for name in "ace"} == {str(PARENT)}
    assert (by["b"] == by["d"] != str(PARENT)) if forks else (by["b"] == by["d"] == str(PARENT))


@pytest.mark.parametrize("name", ["a", "b"])
def test_a_figure_that_cannot_be_drawn_costs_a_warning(tmp_path, forks, name):
    by, warnings = drawn(tmp_path, **{name: wrong})
    assert sorted(by) == sorted(set(NAMES) - {name})
    assert warnings == [f"figure {name!r} can't be drawn (ValueError: no font); all else is written"]


def test_figures_of_a_killed_process_are_drawn_again(tmp_path, monkeypatch):
    monkeypatch.setattr(drawings, "_may_fork", lambda: True)
    by, warnings = drawn(tmp_path, d=killed)
    assert sorted(by) == list(NAMES) and not warnings
    assert by["d"] == "drawn again" and by["b"] == str(PARENT)


def test_an_interrupt_ends_both_processes(tmp_path, monkeypatch):
    monkeypatch.setattr(drawings, "_may_fork", lambda: True)

    def interrupted(path):
        raise KeyboardInterrupt

    before = set(active_children())
    with pytest.raises(KeyboardInterrupt):
        drawn(tmp_path, a=interrupted)
    assert set(active_children()) == before
