"""Terminals of any width: no number is cut, and no text controls them."""

import os
import re

import pytest
from rich.table import Table
from rich.text import Text

from surveysim import load_scene
from surveysim.cli.progress import equal_work, progress_display
from surveysim.forecasting.forecast import forecast
from surveysim.reduction.setup import prepare
from surveysim.report.terminal.forecast import print_forecast
from surveysim.report.terminal.layout import Terminal
from surveysim.runtime.environment import forget_sizes
from surveysim.runtime.numbers import count, plain
from surveysim.runtime.numbers import number as rounded
from tests.scenes import SMALL_SCENE

WIDTHS = (20, 27, 40, 55, 66, 80)
NUMBERS = ["221.1 +- 5.2", "20504.2 +- 1695.1", "not scored"]
EVIL = "\x1b[2J\x1b]0;title\x07\u202e[red]\x00"


def table(words=EVIL):
    made = Table(title=Text(f"A title of words {words}"))
    made.add_column(Text("data set"))
    for heading in ("sigma(A) [uK_CMB^2]", "detectors", "CPU [s]"):
        made.add_column(Text(heading), justify="right")
    for place, number in enumerate(NUMBERS):
        made.add_row(f"masked_36_scaled {words}", number, str(10**place), "0.00123")
    return made


@pytest.mark.parametrize("width", WIDTHS)
def test_numbers_are_whole(monkeypatch, capsys, width):
    monkeypatch.setenv("COLUMNS", str(width))
    Terminal().show(table())
    out = capsys.readouterr().out
    assert "…" not in out and "..." not in out
    found = " ".join(out.split())
    assert [found.count(number) for number in NUMBERS] == [1, 1, 1]
    assert out.count("0.00123") == 3 and len(re.findall(r"\b100\b", out)) == 1
    assert all(letter.isprintable() or letter == "\n" for letter in out) and "[red]" in out


@pytest.mark.parametrize("columns", ["0", "00", "1", "-5", "", "wide", "²", "1000000", "9" * 5000])
def test_columns_that_no_terminal_has(monkeypatch, capsys, columns):
    """Nothing is lost or fails: tables are as wide as they are off a terminal."""
    Terminal().show(table())
    expected = capsys.readouterr().out
    for name in ("COLUMNS", "LINES", "TERMINAL_WIDTH"):
        monkeypatch.setenv(name, columns)
    forget_sizes()
    assert not {"COLUMNS", "LINES", "TERMINAL_WIDTH"} & os.environ.keys()
    Terminal().show(table())
    assert capsys.readouterr().out == expected != ""


@pytest.mark.parametrize("width", WIDTHS)
def test_tables_and_lines_fit(monkeypatch, capsys, width):
    monkeypatch.setenv("COLUMNS", str(width))
    show = Terminal()
    show.show(table("all short"))
    show.say("  - sigma(A) is 20504.2 +- 1695.1 uK_CMB^2, of 12 of 300 observations in all")
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= width
    assert " ".join(" ".join(lines).split()).endswith("20504.2 +- 1695.1 uK_CMB^2, of 12 of 300 observations in all")


@pytest.mark.parametrize("width", range(30, 90))
def test_words_of_headings_are_whole(monkeypatch, capsys, width):
    """rich would shorten the widest column to "uncorre…" where others could be narrower."""
    headings = ("weights", "ell min", "fwhm ell", "actual", "uncorrelated", "masked 36 scaled")
    made = Table(title=Text("The same data scored otherwise"))
    for heading in headings:
        made.add_column(Text(heading), justify="left" if heading == "weights" else "right")
    made.add_row("own and others'", "1000", "1269", "61329", "30147 +- 12", "41456")
    monkeypatch.setenv("COLUMNS", str(width))
    Terminal().show(made)
    out = capsys.readouterr().out
    assert "…" not in out and max(map(len, out.splitlines())) <= width
    for word in ("uncorrelated", "30147 +- 12", "masked", "scaled", "weights", "others'", "61329"):
        assert re.search(rf"(?<!\S){re.escape(word)}(?!\w)", out), out


@pytest.mark.parametrize("long", [False, True])
def test_titles_are_one_line_off_a_terminal(capsys, long):
    title = "Twelve observations: uncertainty on a flat CMB band power" if long else "Two"
    made = Table(title=Text(title))
    made.add_column("data set")
    made.add_row("uncorrelated")
    Terminal().show(made)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == title if long else lines[0].strip() == title and len(lines[0]) == len(lines[1])


def test_paths_are_never_broken(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "20")
    path = "/a-long/path-of/many-parts/that-does/not-fit.html"
    Terminal().say(f"Results in {path}")
    assert path in capsys.readouterr().out.splitlines()


def test_off_a_terminal(monkeypatch, capsys):
    """Lines stay lines, for programs that read them, and tables stay tables."""
    monkeypatch.delenv("COLUMNS", raising=False)
    line = "word " * 60
    Terminal().say(line)
    Terminal().show(table())
    out = capsys.readouterr().out
    assert out.splitlines()[0] == line and "┏" in out


@pytest.mark.parametrize("width", WIDTHS[::2])
def test_forecast_on_a_narrow_terminal(monkeypatch, capsys, tmp_path, width):
    (tmp_path / "small.toml").write_text(SMALL_SCENE)
    scene = load_scene(tmp_path / "small.toml")
    found = forecast(prepare(scene))
    monkeypatch.setenv("COLUMNS", str(width))
    print_forecast(prepare(scene), found)
    out = capsys.readouterr().out
    assert "…" not in out
    assert all(
        plain(rounded(item.band.sigma_ukcmb2)) in out and plain(count(item.band.ell_eff)) in out
        for item in found.scores.values()
    )


@pytest.mark.parametrize("width, bar", [("20", False), ("60", False), ("80", True), ("200", True)])
@pytest.mark.parametrize("term", ["xterm", "dumb"])
def test_progress_on_a_terminal(monkeypatch, capsys, width, bar, term):
    """A bar where it fits beside all numbers; lines elsewhere."""
    monkeypatch.setenv("COLUMNS", width)
    monkeypatch.setenv("TERM", term)
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress_display("first_light", equal_work(12), False) as show:
        for done in range(1, 13):
            show(done, lambda: f"sigma(A) = 2.95e+04 +- 3e+03 uK_CMB^2 {EVIL}")
    error = capsys.readouterr().err
    assert ("━" in error) == (bar and term != "dumb")
    assert "12/12" in error and "…" not in error and EVIL[:4] not in error
    if term == "dumb":
        assert "\x1b" not in error
