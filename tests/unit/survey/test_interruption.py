"""Runs that are interrupted or killed: ended soon, nothing lost, nobody left behind, the same bits."""

import contextlib
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from astropy.io import fits

from surveysim import load_scene
from surveysim import run as run_scene
from surveysim.output.lock import LOCK
from surveysim.runtime.engine import SERIAL
from tests.scenes import SMALL_SCENE, write_scene

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes through /proc")

INTERRUPTED = 200  # observations of runs that are interrupted once a part is done
COMMAND = [sys.executable, "-c", "from surveysim.cli.main import main; main()"]
FAST = [*COMMAND[:2], "import surveysim.survey.run as s; s.CHECKPOINT_SECONDS = 0.1; " + COMMAND[2]]


@pytest.fixture
def scene(tmp_path):
    return write_scene(tmp_path)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The files of the run that is interrupted, from one that is not."""
    folder = tmp_path_factory.mktemp("undisturbed")
    run_scene(load_scene(long_scene(folder, INTERRUPTED)), folder / "whole", engine=SERIAL, figures=False)
    return folder / "whole"


@pytest.mark.parametrize(
    "workers, number, to_group",
    [
        (1, signal.SIGINT, True),
        pytest.param(2, signal.SIGINT, True, marks=pytest.mark.slow),  # of a sweep it is tested every time
        pytest.param(1, signal.SIGTERM, False, marks=pytest.mark.slow),
        pytest.param(2, signal.SIGINT, False, marks=pytest.mark.slow),
        pytest.param(2, signal.SIGTERM, False, marks=pytest.mark.slow),
    ],
)
def test_interruption(tmp_path, undisturbed, workers, number, to_group):
    """Ctrl-C in a terminal (the group), or a request to stop: a checkpoint, one line, nobody left behind."""
    path, out = long_scene(tmp_path, INTERRUPTED), tmp_path / "out"
    options = "--workers", workers, "--save-timestreams", "--no-figures", "-q"
    process = start("run", path, "--out", out, *options, fast=workers > 1)
    # Some are in the sums by then: of one process all that are written, of two those in a checkpoint.
    wait_for(out / ("checkpoint.h5" if workers > 1 else "timestreams/0012.h5"), process)
    begin = time.monotonic()
    (os.killpg if to_group else os.kill)(process.pid, number)
    _, error = process.communicate(timeout=20)
    assert time.monotonic() - begin < 5
    assert (process.returncode, error) == (130, f"interrupted; go on with: {resuming(process)}\n")
    assert none_left(process.pid) and not list(out.rglob("*.part")) and not (out / LOCK).exists()
    run_scene(load_scene(path), out, engine=SERIAL, resume=True, figures=False)
    assert_same_results(out, undisturbed)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.7, 1.2, 1.6, 2.0, 2.5, 3.0])
def test_interruption_of_the_start(tmp_path, scene, delay):
    """Whatever is under way: imports, the start of the workers, their imports, or observations, which last long."""
    process = start("run", scene, "--set", "observations=20000", "--out", tmp_path / "o", "--workers", 2, "-q")
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=20)
    assert process.returncode == 130 and none_left(process.pid)
    assert error.startswith("interrupted") and len(error.splitlines()) == 1


def long_scene(tmp_path, observations):
    path = tmp_path / "long.toml"
    path.write_text(SMALL_SCENE.replace("observations = 4", f"observations = {observations}"))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["processes", "dask"])
def test_killed_worker(tmp_path, undisturbed, engine):
    """Its work is done again: the run ends as if nothing had been, with the same bits."""
    path, out = long_scene(tmp_path, INTERRUPTED), tmp_path / "out"
    process = start(
        *("run", path, "--out", out, "--workers", 2, "--engine", engine, "--save-timestreams", "--no-figures", "-q")
    )
    wait_for(out / "timestreams" / "0012.h5", process)
    os.kill(worker_of(process.pid), signal.SIGKILL)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 0 and none_left(process.pid) and not list(out.rglob("*.part"))
    assert error == ("a worker process is gone; its work is done again\n" if engine == "processes" else "")
    assert_same_results(out, undisturbed)


@pytest.mark.slow
def test_killed_parent(tmp_path):
    """No worker stays behind."""
    path, out = long_scene(tmp_path, 2000), tmp_path / "out"
    process = start("run", path, "--out", out, "--workers", 2, "--save-timestreams", "-q")
    wait_for(out / "timestreams" / "0012.h5", process)
    process.kill()
    process.communicate(timeout=20)
    assert none_left(process.pid)


@pytest.mark.slow
def test_killed_and_resumed(tmp_path):
    """A run on dask is killed, before anything is kept and in its middle: the same bits and files as whole.

    The other engines are killed by `tests/stress/test_kills.py`, at random.
    """
    path, out, whole = long_scene(tmp_path, 60), tmp_path / "out", tmp_path / "whole"
    how = ("--engine", "dask", "--workers", 1, "--no-figures", "-q", "--save-timestreams")
    run_scene(load_scene(path), whole, engine=SERIAL, figures=False, save_timestreams=True)
    for seen in (LOCK, "timestreams/0030.h5"):
        process = start("run", path, "--out", out, *how, fast=True)
        wait_for(out / seen, process)
        process.kill()
        process.communicate(timeout=20)
        assert none_left(process.pid)
        process = start("run", path, "--out", out, "--resume", *how, fast=True)
        _, error = process.communicate(timeout=60)
        assert process.returncode == 0 and not error.startswith("Traceback")
        assert_same_results(out, whole)
        assert files(out) == files(whole)
        shutil.rmtree(out)


def files(directory):
    return sorted(path.relative_to(directory).as_posix() for path in directory.rglob("*"))


def start(*arguments, fast=False):
    """The command in a group of its own; a `fast` one saves a checkpoint ten times a second."""
    environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
    return subprocess.Popen(
        [*(FAST if fast else COMMAND), *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    )


def resuming(process):
    """The command that resumes an interrupted one."""
    return shlex.join(["surveysim", *process.args[len(COMMAND) :], "--resume"])


def wait_for(path, process, seconds=60):
    end = time.monotonic() + seconds
    while not path.exists():
        assert process.poll() is None and time.monotonic() < end
        time.sleep(0.01)


def processes():
    """(pid, parent, group, command) of each live process."""
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if fields[0] != "Z":
                yield int(entry.name), int(fields[1]), int(fields[2]), (entry / "cmdline").read_text()


def worker_of(pid):
    """A worker of the process: a child of the process that workers are forked from, or of dask its own child."""
    own = [(item, command) for item, parent, _, command in processes() if parent == pid]
    servers = [item for item, command in own if "forkserver" in command]
    forked = [item for item, parent, _, _ in processes() if parent in servers]
    return (forked or [item for item, command in own if "spawn_main" in command])[0]


def none_left(group, seconds=5):
    end = time.monotonic() + seconds
    while left := [item for item in processes() if item[2] == group]:
        if time.monotonic() > end:
            pytest.fail(f"left behind: {left}")
        time.sleep(0.05)
    return True


def assert_same_results(one, other):
    names = sorted(path.name for path in (one / "maps").glob("*.fits"))
    assert names and names == sorted(path.name for path in (other / "maps").glob("*.fits"))
    for name in names:
        with fits.open(one / "maps" / name) as a, fits.open(other / "maps" / name) as b:
            for left, right in zip(a, b, strict=True):
                np.testing.assert_array_equal(left.data, right.data)
    summaries = [json.loads((path / "summary.json").read_text()) for path in (one, other)]
    for key in ("scores", "gains", "error_budget", "alternatives", "scans_discarded", "mean_iterations"):
        assert summaries[0][key] == summaries[1][key]
