"""Commands that fail: one line, an exit code, and a file with the details of a fault of this program."""

import contextlib
import errno
import signal
import sys
import tempfile
import tomllib
from pathlib import Path

import pytest
import typer

from mapmaker.printable import LONGEST, MOST_LINES, printable, short_lines, shortened
from surveysim.cli import interrupts, options
from surveysim.cli.main import ended
from surveysim.runtime.engine import EngineError
from surveysim.runtime.errors import SceneError
from tests.scenes import SMALL_SCENE, write_scene

EVIL = "\x1b[31mred\x07\r\n\u202eevil\u2028\x9b1m\udc80"  # without NUL, which no argument has


@pytest.fixture
def fail(monkeypatch, tmp_path, capsys, handlers):
    """Run `check` on a scene whose reading raises an error; returns exit code, output, lines of error and new files."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def fail(error):
        def load(*arguments):
            raise error

        before = set(tmp_path.iterdir())
        monkeypatch.setattr("surveysim.scene.scene.load_scene", load)
        monkeypatch.setattr("surveysim.scene.kinds.is_sweep", lambda path: False)
        monkeypatch.setattr("surveysim.scene.kinds.has_bands", lambda path: False)
        code = ended(["check", f"a{EVIL}.toml"])
        text = capsys.readouterr()
        return code, text.out, text.err.splitlines(), sorted(set(tmp_path.iterdir()) - before)

    return fail


@pytest.mark.parametrize(
    "error",
    [
        ZeroDivisionError("division by zero"),
        AttributeError(EVIL),
        KeyError("x" * 100_000),
        RecursionError("maximum recursion depth exceeded"),
        UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
        UnicodeEncodeError("ascii", "\udc80", 0, 1, "ordinal not in range"),
        ImportError("libhdf5.so: cannot open shared object file"),
        AssertionError(),
        GeneratorExit(),
    ],
    ids=lambda error: type(error).__name__,
)
def test_fault_of_the_program(fail, tmp_path, error):
    (tmp_path / "surveysim-error-mine.txt").write_text("mine")
    code, out, lines, made = fail(error)
    assert (code, out, len(lines), len(made)) == (1, "", 1, 1)
    assert lines[0].startswith(f"surveysim can't go on: {type(error).__name__}: ") and lines[0].endswith(f"{made[0]}")
    assert lines[0].isprintable() and len(lines[0]) <= LONGEST
    details = made[0].read_text(encoding="utf-8")
    assert all(word in details for word in ("surveysim 0", "Python 3", "'check'", "Traceback", type(error).__name__))
    assert made[0].stat().st_mode & 0o077 == 0
    assert (tmp_path / "surveysim-error-mine.txt").read_text() == "mine"
    assert fail(error)[3] != made


def test_fault_whose_details_cannot_be_written(fail, monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "missing"))
    code, out, lines, made = fail(ZeroDivisionError("by zero"))
    assert (code, out, made) == (1, "", [])
    assert lines == [
        "surveysim can't go on: ZeroDivisionError: by zero (its details can't be written: No such file or directory)"
    ]


@pytest.mark.parametrize(
    "error, code, line",
    [
        (SceneError("a.toml: seed: found x"), 2, "a.toml: seed: found x"),
        (OSError(errno.ENOSPC, "No space left on device", "o/map.fits"), 1, "o/map.fits: No space left on device"),
        (OSError(errno.EIO, "Input/output error"), 1, "output: Input/output error"),
        (
            OSError(errno.EMFILE, "Too many open files", "o/map.fits"),
            1,
            "o/map.fits: too many open files; raise the limit ('ulimit -n') or take fewer workers",
        ),
        (FileNotFoundError(errno.ENOENT, "No such file"), 1, "the working directory is gone; change to another"),
        (MemoryError(), 1, "not enough memory for this scene; 'surveysim plan SCENE' says how much it needs"),
        (EngineError("the scheduler is gone"), 1, "the scheduler is gone"),
        (BrokenPipeError(errno.EPIPE, "Broken pipe"), 1, "output: Broken pipe"),  # not of a standard stream
        (KeyboardInterrupt(), 130, "interrupted"),
        (SystemExit(3), 3, None),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else None,
)
def test_errors_of_users_and_machines(fail, error, code, line):
    """No file with details: the line says it all."""
    assert fail(error) == (code, "", [] if line is None else [line], [])


@pytest.mark.parametrize(
    "error", [ImportError("numpy can't be loaded twice"), RuntimeError("__set_name__"), KeyError()]
)
def test_interrupt_that_became_another_error(fail, monkeypatch, error):
    """An import may wrap it: it is an interrupt all the same."""
    monkeypatch.setattr("surveysim.cli.main.interrupt_work", lambda clean_up: None)
    monkeypatch.setattr("mapmaker.stop_signals._asked", [0.0])
    assert fail(error) == (130, "", ["interrupted"], [])


def test_interrupt_that_was_lost(monkeypatch, capsys, handlers):
    """As in a finalizer: the command goes on to its end, and its exit code says so."""
    monkeypatch.setattr("surveysim.cli.checks.sweep_of", lost_interrupt)
    assert ended(["check", "a.toml"]) == 130
    assert capsys.readouterr() == ("", "interrupted too late: the command is finished\n")


def lost_interrupt(*arguments):
    with contextlib.suppress(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    raise typer.Exit


def test_interrupt_that_became_the_loss_of_workers(monkeypatch, capsys, handlers, tmp_path):
    monkeypatch.setattr("mapmaker.stop_signals._asked", [0.0])
    with pytest.raises(typer.Exit) as end, interrupts.report_resumable_exit(tmp_path, tmp_path):
        raise EngineError("the scheduler is gone")
    assert end.value.exit_code == 130
    said = "interrupted: the scheduler is gone; no work is kept, the same command starts anew\n"
    assert capsys.readouterr().err == said


def test_interrupted_while_a_command_runs(monkeypatch, capsys, handlers, tmp_path):
    monkeypatch.setattr("surveysim.cli.checks.sweep_of", lambda *arguments: signal.raise_signal(signal.SIGTERM))
    assert ended(["check", "a.toml"]) == 130
    assert capsys.readouterr() == ("", "interrupted\n")


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["run"], "Missing argument 'SCENE'"),
        (["run", "a.toml", "--workers", f"x{EVIL}"], "Invalid value for '--workers'"),
        ([f"chek{EVIL}"], "No such command"),
        (["check", "a.toml", f"--{EVIL}"], "No such option"),
        (["accuracy", "a.toml", "--reference-error", "0"], "--reference-error: found 0; 0.0001 to 0.99 is expected"),
        (["accuracy", "a.toml", "--seeds", "0"], "--seeds: found 0; 1 or more is expected"),
        (["accuracy", "a.toml", "--observations", "1"], "--observations: found 1; 2 or more is expected"),
        (["run", "a.toml", "--engine", f"x{EVIL}"], "--engine: found"),
        (["check", f"{EVIL}/nothing.toml"], "can't be read"),
        (["run", "a.toml", "--scheduler", "x" * 10_000, "--engine", "serial"], "scheduler: found one"),
        (["paper", "--all", "--set", "y" * 10_000], "KEY=VALUE is expected"),
        (["paper", "--explain", "--table", "1"], "--explain: found with --table, --figure or --all; it stands alone"),
        (["paper", "--explain", "--observations", "7"], "--observations: found 7; 8 or more is expected"),
    ],
)
def test_wrong_command_lines(capsys, handlers, arguments, words):
    assert ended(arguments) == 2
    out, error = capsys.readouterr()
    assert out == "" and words in error and len(error.splitlines()) == 1
    assert error[:-1].isprintable() and len(error) <= LONGEST + 1


@pytest.mark.parametrize(
    "setting",
    [
        "a." * 3000 + "a=1",
        "scan.speed=" + "[" * 5000,
        "scan.speed=" + "[" * 5000 + "]" * 5000,
        "scan.speed=" + "{a=" * 3000 + "1" + "}" * 3000,
        f"sc{EVIL}an.speed=1",
        "k" * 100_000 + "=1",
        "scan.speed=" + "9" * 5000,
        "scan.duration=1e308 s",
        f"scan.duration={EVIL}",
    ],
    ids=lambda text: ascii(text[:15]),
)
def test_odd_settings(capsys, handlers, tmp_path, setting):
    path = write_scene(tmp_path)
    assert ended(["check", str(path), "--set", setting]) == 2
    out, error = capsys.readouterr()
    assert out == "" and error[:-1].isprintable() and len(error) <= LONGEST + 1
    assert [item.name for item in tmp_path.iterdir()] == ["small.toml"]


def test_settings_that_are_nested_as_scenes_are():
    assert options.setting("score.signal_sims.skies=4") == ("score.signal_sims.skies", 4)
    assert options.setting("a.b.c.d.e.f.g.h.i.j=1")[1] == 1
    with pytest.raises(SceneError, match="found 11 names"):
        options.setting("a.b.c.d.e.f.g.h.i.j.k=1")


@pytest.mark.parametrize(
    "content", [SMALL_SCENE.encode() + "# \u00fc".encode("latin-1"), b"\xff\xfe", b"x = " + b"[" * 9999]
)
def test_new_scene_like_a_file_that_is_none(capsys, handlers, monkeypatch, tmp_path, content):
    monkeypatch.chdir(tmp_path)
    Path("like.toml").write_bytes(content)
    assert ended(["new", "mine", "--like", "like.toml"]) == 2
    out, error = capsys.readouterr()
    assert out == "" and error.startswith("like.toml: ") and len(error.splitlines()) == 1
    assert [item.name for item in tmp_path.iterdir()] == ["like.toml"]


# ---------------------------------------------------------------- texts


@pytest.mark.parametrize(
    "letter", ["\x00", "\x1b", "\n", "\r", "\x7f", "\x9b", "\u200f", "\u2028", "\u202e", "\udcff", "\ufeff"]
)
def test_letters_that_control_a_terminal(letter):
    shown = printable(f"a{letter}b")
    assert shown.isprintable() and shown.startswith("a\\") and shown.endswith("b")
    assert shown.encode("ascii").decode("unicode_escape") == f"a{letter}b"


@pytest.mark.parametrize("text", ["", "plain", "µK² ü 中 😀", "a  b [bold] :smile:"])
def test_texts_that_stay(text):
    assert printable(text) == short_lines(text) == text


@pytest.mark.parametrize("length", [LONGEST - 1, LONGEST, LONGEST + 1, 10**6])
def test_long_lines_keep_both_ends(length):
    line = "file: key: " + "x" * (length - 22) + "is expected"
    shown = shortened(line)
    assert len(shown) == min(length, LONGEST) and shown.startswith("file: key: ") and shown.endswith("is expected")
    assert (shown == line) == (length <= LONGEST)


def test_many_lines():
    lines = short_lines("\n".join(f"line {number}" for number in range(1000))).split("\n")
    assert len(lines) == MOST_LINES + 1 and lines[-1] == f"and {1000 - MOST_LINES} more"
    assert short_lines("\n".join("x" * MOST_LINES)).count("x") == MOST_LINES


def test_version_of_the_entry_point():
    """The installed command and ``python -m surveysim`` are the same function."""
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())
    assert project["project"]["scripts"]["surveysim"] == "surveysim.cli.main:main"


def test_libraries_that_can_not_be_loaded(capfd, monkeypatch):
    """As where memory is short: one line, whatever is missing."""
    monkeypatch.setitem(sys.modules, "surveysim.cli.failures", None)
    assert ended(["check", "small.toml"]) == 1
    out, error = capfd.readouterr()
    assert out == "" and error.startswith("surveysim can't start: ") and len(error.splitlines()) == 1


def test_libraries_that_do_not_fit_into_memory(capsys, handlers, monkeypatch):
    def run(arguments):
        raise ImportError("x.so: failed to map segment from shared object")

    monkeypatch.setattr("surveysim.cli.main._run", run)
    assert ended(["check", "small.toml"]) == 1
    assert (
        capsys.readouterr().err == "not enough memory for this scene; 'surveysim plan SCENE' says how much it needs\n"
    )
