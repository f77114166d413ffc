"""Commands of the stress tests, each in a process group of its own."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.entry import FUNCTION, MODULE
from tests.scenes import SMALL_SCENE

# Checkpoints ten times a second: there is something to go on from, wherever a run is killed.
FAST = f"import surveysim.survey.run as s; s.CHECKPOINT_SECONDS = 0.1; from {MODULE} import {FUNCTION}; {FUNCTION}()"
SCENE = SMALL_SCENE.replace("observations = 4", "observations = 16")
SWEEP = SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "").replace("observations = 4", "observations = 6")
SWEEP += '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s", "5 arcmin / s", "6 arcmin / s"]\n'
LONGEST_S = 300


def start(root: Path, *arguments: str) -> subprocess.Popen:
    """Start a command with its working directory in `root`."""
    tree = Path(__file__).parents[2]
    environment = os.environ | {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONPATH": str(tree)}
    return subprocess.Popen(
        [sys.executable, "-c", FAST, *arguments],
        cwd=root,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    )


def ended(process: subprocess.Popen) -> tuple[int, str]:
    """Exit code and errors of a command, with all of its group gone."""
    try:
        _, error = process.communicate(timeout=LONGEST_S)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    assert none_left(process.pid), f"processes left behind by {process.args[3:]}"
    return process.returncode, error


def members(group: int) -> list[int]:
    """Live processes of a group."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if fields[0] != "Z" and int(fields[2]) == group:
                found.append(int(entry.name))
    return found


def none_left(group: int, seconds: float = 15) -> bool:
    """Whether a group ends within some seconds; ends it otherwise."""
    end = time.monotonic() + seconds
    while members(group):
        if time.monotonic() > end:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(group, signal.SIGKILL)
            return False
        time.sleep(0.02)
    return True
