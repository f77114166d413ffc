"""The program `mapmaker`: quick help, exit codes, and one line for each failure."""

import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import pytest

from mapmaker.cli import app, main

HEAVY = {"numpy", "numba", "scipy", "astropy", "h5py", "healpy", "matplotlib", "pydantic", "rich.progress"}


@pytest.mark.parametrize("arguments, code", [(["--help"], 0), (["--version"], 0), ([], 2)])
def test_help_loads_nothing_heavy(arguments, code):
    program = (
        "import sys\nfrom mapmaker.cli.main import ended\n"
        f"assert ended(sys.argv[1:]) == {code}\nprint(' '.join(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert not HEAVY & set(done.stdout.splitlines()[-1].split())
    assert ("mapmaker" if "--version" in arguments else "Usage: mapmaker") in done.stdout


def test_an_unknown_command(capsys):
    assert main.ended(["nosuch"]) == 2
    assert capsys.readouterr().err == "No such command 'nosuch'. ('mapmaker --help' says more)\n"


@pytest.mark.parametrize(
    "error, code, line",
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (MemoryError(), 1, "not enough memory"),
        (OSError(28, "No space left on device", "map.fits"), 1, "map.fits: No space left on device"),
        (ValueError("a\nbug"), 1, "mapmaker can't go on: ValueError: a\\nbug; please report it with its details in "),
    ],
)
def test_a_failure_is_one_line(error, code, line, capsys, monkeypatch, tmp_path):
    def failing(arguments):
        raise error

    monkeypatch.setattr(main, "_run", failing)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert main.ended(["x"]) == code
    said = capsys.readouterr().err
    assert said.startswith(line) and said.count("\n") == 1
    assert len(list(tmp_path.iterdir())) == isinstance(error, ValueError)


def test_each_command_has_a_summary():
    for command in app.COMMANDS:
        assert command.__doc__.strip().splitlines()[0].endswith(".")


def test_the_entry_point():
    project = tomllib.loads((Path(__file__).parents[4] / "pyproject.toml").read_text())
    assert project["project"]["scripts"]["mapmaker"] == f"{main.__name__}:main"
