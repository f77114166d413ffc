"""Fixtures of the command line's tests."""

import signal
import sys
from functools import cache

import pytest
from PIL import Image
from typer.main import get_command

from mapmaker import stop_signals
from surveysim.cli.main import main
from tests.scenes import write_scene

get_command_once = cache(get_command)  # a process of a user's runs one command


@pytest.fixture
def handlers():
    """The entry points set signal handlers; a test run keeps its own, and forgets the signals of a test."""
    kept = {number: signal.getsignal(number) for number in stop_signals.NUMBERS}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)
    stop_signals._asked.clear()


@pytest.fixture(scope="module")
def blank_figures():
    """Figures of a run are made and not rendered, which takes most of their time: blank images instead."""

    def save(figure, path, full_colour=False):
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", (60, 40)).save(path)

    with pytest.MonkeyPatch.context() as patch:
        for module in ("survey",):
            patch.setattr(f"surveysim.report.figures.{module}.save", save)
        yield


@pytest.fixture
def scene_file(tmp_path):
    return write_scene(tmp_path)


@pytest.fixture
def call(monkeypatch, capsys, handlers):
    """Run the command line here; returns exit code, standard output and error."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["surveysim", *map(str, arguments)])
        monkeypatch.setattr("surveysim.runtime.environment.settle", lambda: None)  # its changes last
        monkeypatch.setattr("typer.main.get_command", get_command_once)
        monkeypatch.setattr("mapmaker.kernels.compiled.is_cached", lambda kernel: True)  # or the first test says more
        with pytest.raises(SystemExit) as end:
            main()
        text = capsys.readouterr()
        return end.value.code or 0, text.out, text.err

    return call
