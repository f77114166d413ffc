"""Runs that are interrupted or killed: ended soon, nothing lost, nobody left behind, the same bits."""

import contextlib
import json
import os
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
from tests.scenes import SMALL_SCENE

pytestmark = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes through /proc")

COMMAND = [sys.executable, "-c", "from surveysim.cli import main; main()"]


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SMALL_SCENE)
    return path


@pytest.mark.parametrize(
    "workers, number, to_group",
    [
        (1, signal.SIGINT, True),
        (2, signal.SIGINT, True),
        pytest.param(1, signal.SIGTERM, False, marks=pytest.mark.slow),
        pytest.param(2, signal.SIGINT, False, marks=pytest.mark.slow),
        (2, signal.SIGTERM, False),
    ],
)
def test_interruption(tmp_path, workers, number, to_group):
    """Ctrl-C in a terminal (the group), or a request to stop: a checkpoint, one line, nobody left behind."""
    path, out = tmp_path / "long.toml", tmp_path / "out"
    path.write_text(SMALL_SCENE.replace("observations = 4", "observations = 200"))
    process = start("run", path, "--out", out, "--workers", workers, "--save-timestreams", "--no-figures", "-q")
    # At most seven are under way: some are in the sums by then.
    wait_for(out / "timestreams" / "0012.h5", process)
    begin = time.monotonic()
    (os.killpg if to_group else os.kill)(process.pid, number)
    _, error = process.communicate(timeout=20)
    assert time.monotonic() - begin < 5
    assert (process.returncode, error) == (130, f"interrupted; go on with --resume --out {out}\n")
    assert none_left(process.pid) and not list(out.rglob("*.part"))
    scene = load_scene(path)
    run_scene(scene, out, workers=1, resume=True, figures=False)
    run_scene(scene, tmp_path / "whole", workers=1, figures=False)
    assert_same_results(out, tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.7, 1.2, 1.6, 2.0, 2.5, 3.0])
def test_interruption_of_the_start(tmp_path, scene, delay):
    """Whatever is under way: imports, the start of the workers, or their imports."""
    process = start("run", scene, "--set", "observations=1000", "--out", tmp_path / "o", "--workers", 2, "-q")
    time.sleep(delay)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=20)
    assert process.returncode in (130, -signal.SIGINT) and none_left(process.pid)
    if process.returncode == 130:
        assert error.startswith("interrupted") and len(error.splitlines()) == 1


@pytest.mark.parametrize("victim", ["worker", "parent"])
def test_killed_process(tmp_path, victim):
    path, out = tmp_path / "long.toml", tmp_path / "out"
    path.write_text(SMALL_SCENE.replace("observations = 4", "observations = 2000"))
    process = start("run", path, "--out", out, "--workers", 2, "--save-timestreams", "-q")
    wait_for(out / "timestreams" / "0012.h5", process)
    os.kill(worker_of(process.pid) if victim == "worker" else process.pid, signal.SIGKILL)
    _, error = process.communicate(timeout=20)
    assert none_left(process.pid)
    if victim == "worker":
        assert process.returncode == 1 and (out / "checkpoint.npz").exists()
        assert error.startswith("a worker process is gone") and len(error.splitlines()) == 1
        assert f"--resume --out {out}" in error and not list(out.rglob("*.part"))


def start(*arguments):
    environment = os.environ | {"NUMBA_NUM_THREADS": "1"}
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    )


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
    return next(item for item, parent, _, command in processes() if parent == pid and "spawn_main" in command)


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
