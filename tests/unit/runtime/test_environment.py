"""Environments of all kinds: without a home, streams, a directory to write to, or a clean set of variables."""

import contextlib
import logging
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numba
import pytest

from mapmaker.kernels import compiled
from mapmaker.printable import printable
from surveysim.runtime import environment
from tests.scenes import SMALL_SCENE, WHITE_NOISE_SCENE, write_scene

COMMAND = [sys.executable, "-m", "surveysim"]
ROOT = Path(__file__).parents[3]


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path)


# ---------------------------------------------------------------- caches


@pytest.fixture
def home(monkeypatch, tmp_path):
    """A home directory that is like the user's, and no other variable that says where caches go."""
    home = tmp_path / "home"
    home.mkdir()
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    for name in ("XDG_CACHE_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.setenv(name, "")
    yield home
    environment.clean_up()


def test_home_that_can_be_written(home, tmp_path):
    assert environment.provide_caches() is None
    assert os.environ["HOME"] == str(home) and list(tmp_path.iterdir()) == [home] and not list(home.iterdir())


@pytest.mark.parametrize(
    "spoil, words",
    [
        (lambda home: home.rmdir(), "found no home directory"),
        (lambda home: (home.rmdir(), home.write_text("mine")), "found no home directory"),
        (lambda home: (home.rmdir(), home.symlink_to(home)), "found no home directory"),
        (lambda home: (home / ".cache").write_text("mine"), "can't both be written"),
        (lambda home: (home / ".config").symlink_to(home / "nowhere"), "can't both be written"),
    ],
)
def test_home_that_cannot_be_written(home, tmp_path, spoil, words):
    spoil(home)
    before = set(tmp_path.iterdir())
    line = environment.provide_caches()
    assert line.startswith("no cache: ") and words in line and "\n" not in line
    (made,) = set(tmp_path.iterdir()) - before
    assert os.environ["HOME"] == str(made) and made.stat().st_mode & 0o077 == 0
    assert os.environ["XDG_CACHE_HOME"] == str(made / ".cache")
    (made / ".cache").mkdir()
    environment.clean_up()
    assert set(tmp_path.iterdir()) == before


def test_no_directory_at_all(home, monkeypatch):
    """Caches go nowhere, and not into a folder "~" of the working directory."""
    home.rmdir()
    monkeypatch.setattr("tempfile.tempdir", str(home / "missing"))
    assert environment.provide_caches().startswith("no cache: ")
    assert os.environ["HOME"] == os.devnull
    with pytest.raises(OSError):
        os.makedirs(os.environ["XDG_CACHE_HOME"])


def test_kernels_without_a_cache(monkeypatch, caplog):
    """Numba refuses to cache where it can write to no directory: the function is compiled all the same."""
    asked, njit = [], numba.njit

    def refusing(cache=False, **options):
        asked.append(cache)
        if cache:
            raise RuntimeError("cannot cache function 'double': no locator available")
        return njit(**options)

    compiled._say_once.cache_clear()
    with caplog.at_level(logging.WARNING, "mapmaker"), monkeypatch.context() as patch:
        patch.setattr(numba, "njit", refusing)
        functions = [compiled.njit(cache=True, nogil=True)(lambda x: 2 * x) for _ in range(2)]
    assert [function(3) for function in functions] == [6, 6] and asked == [True, False] * 2
    assert len(caplog.records) == 1 and "NUMBA_CACHE_DIR" in caplog.text


@pytest.fixture
def open_place():
    """A directory that any user can reach and write to."""
    with tempfile.TemporaryDirectory(dir="/tmp") as name:
        os.chmod(name, 0o777)
        yield Path(name)


@pytest.mark.skipif(not shutil.which("setpriv") or os.geteuid() != 0, reason="takes another user's number")
@pytest.mark.parametrize(
    "home", [None, *(pytest.param(name, marks=pytest.mark.slow) for name in ("/nowhere", "/root"))]
)
def test_user_without_a_name_home_or_rights(open_place, home):
    """Read-only installation, unknown user: `check` runs, says that it has no cache, and leaves nothing behind."""
    scene = open_place / "small.toml"
    scene.write_text(SMALL_SCENE)
    # It may read all, as Python's own files may be root's, and write nothing.
    able = "setpriv --reuid 54321 --regid 54321 --clear-groups --inh-caps +dac_read_search --ambient-caps"
    variables = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CACHE_HOME")}
    variables |= {"PYTHONPATH": str(ROOT), "TMPDIR": str(open_place)} | ({} if home is None else {"HOME": home})
    done = subprocess.run(
        [*shlex.split(able), "+dac_read_search", *COMMAND, "check", str(scene)],
        cwd=open_place,
        env=variables,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout) == (
        0,
        f"{scene}: 'small' is a scene that can be run\n18 detectors; 1 dead position of 19\n",
    )
    assert done.stderr.startswith("no cache: ") and len(done.stderr.splitlines()) == 1
    assert list(open_place.iterdir()) == [scene]


# ---------------------------------------------------------------- streams, variables and flags


def test_warnings_as_errors_on_an_ascii_terminal(tmp_path):
    """Libraries that warn when they are imported; letters that the terminal does not have, and a closed input."""
    path = tmp_path / "ümlaut µ.toml"
    path.write_text('name = "small"\n' + SMALL_SCENE)
    variables = {"PYTHONIOENCODING": "ascii", "LC_ALL": "C", "TZ": "Asia/Kathmandu", "TERM": "dumb", "NO_COLOR": "1"}
    variables |= {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "error"}
    done = subprocess.run(
        [sys.executable, "-W", "error", *COMMAND[1:], "check", str(path)],
        cwd=ROOT,
        env=os.environ | variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.isascii() and done.stdout.endswith(
        "'small' is a scene that can be run\n18 detectors; 1 dead position of 19\n"
    )


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    "redirect, code, said",
    [
        (">&- 2>&- <&-", 0, ""),
        (">/dev/full", 1, "standard output: No space left on device\n"),
        ("| true", 141, ""),
        pytest.param(">&-", 0, "", marks=pytest.mark.slow),
        pytest.param(">/dev/full 2>/dev/full", 1, "", marks=pytest.mark.slow),
        pytest.param("2>&1 | true", 141, "", marks=pytest.mark.slow),
    ],
)
def test_streams_that_cannot_be_written(redirect, code, said):
    """Combined with the help, which is quick."""
    command = f"set -o pipefail; {sys.executable} -m surveysim --help {redirect}"
    variables = os.environ | {"PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": ""}
    done = subprocess.run(["bash", "-c", command], cwd=ROOT, env=variables, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", said)


def test_streams_here(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    environment.open_streams()
    for stream in (sys.stdout, sys.stderr):
        print("ü", file=stream, flush=True)
        assert stream.name == os.devnull
        stream.close()


def test_libraries_are_silent(monkeypatch, capsys):
    monkeypatch.setattr(sys, "warnoptions", ["error"])
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    for name in ("unraisablehook", "excepthook"):
        monkeypatch.setattr(sys, name, getattr(sys, name))
    monkeypatch.setattr("threading.excepthook", None)
    log, root = logging.getLogger("surveysim"), logging.getLogger()
    kept = list(root.handlers)
    with warnings.catch_warnings():
        try:
            environment.silence_libraries()
            warnings.warn("of a library", RuntimeWarning, stacklevel=1)
            logging.getLogger("distributed").warning("of a library")
            log.warning("a worker\x1b is gone")
        finally:
            log.handlers.clear()
            root.handlers[:] = kept
    assert sys.warnoptions == [os.environ["PYTHONWARNINGS"]] == ["ignore"]
    assert capsys.readouterr() == ("", printable("a worker\x1b is gone") + "\n")


@pytest.mark.parametrize("flags", [["-X", "dev"], ["-b"], ["-bb"]], ids=" ".join)
def test_flags_that_add_warnings(flags):
    """Python takes them out of its options again when it starts a worker."""
    code = "from surveysim.runtime.environment import silence_libraries; silence_libraries();"
    code += "from subprocess import _args_from_interpreter_flags as a; print(*a())"
    variables = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, *flags, "-c", code], env=variables, capture_output=True, text=True)
    assert done.returncode == 0 and "-Wignore" in done.stdout and flags[-1] in done.stdout, done.stderr


# ---------------------------------------------------------------- the first moment, and scripts


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_interrupted_in_the_first_half_second(scene, number):
    """Once Python has started and loaded the entry point, whatever is being imported."""
    code = "import os, sys\nfrom surveysim.cli.main import main\nos.write(1, b'x')\nmain()"
    for delay in (0.05, 0.2, 0.4):
        process = subprocess.Popen(
            [sys.executable, "-c", code, "run", str(scene), "-q"],
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            cwd=scene.parent,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert process.stdout.read(1) == "x"
        time.sleep(delay)
        process.send_signal(number)
        out, error = process.communicate(timeout=20)
        assert (process.returncode, out, error) == (130, "", "interrupted\n")
    assert [path.name for path in scene.parent.iterdir()] == ["small.toml"]


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["processes", "dask"])
@pytest.mark.parametrize("from_file", [True, False])
def test_script_without_a_guard(tmp_path, engine, from_file):
    """Workers do not run the calling script again, nor do they look for one that came through standard input."""
    (tmp_path / "white.toml").write_text(WHITE_NOISE_SCENE)
    script = (
        f"import surveysim\nscene = surveysim.load_scene('white.toml')\nengine = surveysim.Engine({engine!r}, 2)\n"
        "print(surveysim.run(scene, engine=engine).coadds.done)\n"
    )
    (tmp_path / "script.py").write_text(script)
    with contextlib.ExitStack() as stack:
        given = stack.enter_context((tmp_path / "script.py").open())
        done = subprocess.run(
            [sys.executable, *(["script.py"] if from_file else ["-"])],
            stdin=given,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=120,
        )
    assert (done.returncode, done.stdout, done.stderr) == (0, "4\n", "")
