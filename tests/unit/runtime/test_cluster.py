"""Clusters whose scheduler and workers come and go: the same bits, or a checkpoint to go on from."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

import surveysim
from surveysim import __version__, load_scene
from surveysim import run as run_scene
from surveysim.runtime.engine import SERIAL
from tests.unit.survey.test_interruption import assert_same_results, long_scene, resuming, start, wait_for

ROOT = Path(surveysim.__file__).parents[1]
DASK = ("--engine", "dask", "--scheduler")
# A process with this module can't import the program, even where it is installed.
HIDDEN = """
import sys


class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("surveysim", "mapmaker"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, Hidden())
"""


@contextmanager
def cluster(file, worker_path=ROOT):
    """A scheduler with one worker, and a function that starts another; all are gone in the end.

    Workers import from `worker_path` first.
    """
    crew = []

    def member(*arguments):
        command = [sys.executable, "-m", f"distributed.cli.dask_{arguments[0]}", *map(str, arguments[1:])]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        quiet |= {"env": os.environ | {"PYTHONPATH": str(worker_path)}, "cwd": file.parent}
        local = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")
        crew.append(subprocess.Popen([*command, *local, "--scheduler-file", file, "--no-dashboard"], **quiet))
        return crew[-1]

    try:
        scheduler = member("scheduler", "--port", "0")
        wait_for(file, scheduler)
        yield scheduler, member("worker", "--nthreads", "1"), lambda: member("worker", "--nthreads", "1")
    finally:
        for each in crew:
            os.killpg(each.pid, signal.SIGKILL)
            each.wait()


def of_cluster(path, out, file):
    """A run on it, once some of it is kept."""
    process = start("run", path, "--out", out, *DASK, file, "--no-figures", "-q", fast=True)
    wait_for(out / "checkpoint.h5", process)
    return process


@pytest.mark.slow
def test_lost_scheduler(tmp_path):
    """The run ends with its checkpoint whole, and goes on from there."""
    path, out, file = long_scene(tmp_path, 400), tmp_path / "out", tmp_path / "scheduler.json"
    with cluster(file) as (scheduler, _, _):
        process = of_cluster(path, out, file)
        scheduler.kill()
        _, error = process.communicate(timeout=60)
    assert process.returncode == 1
    assert error == f"the scheduler of the cluster is gone; go on with: {resuming(process)}\n"
    assert sorted(item.name for item in out.iterdir()) == [".surveysim.json", "checkpoint.h5", "scene.toml"]
    run_scene(load_scene(path), out, engine=SERIAL, resume=True, figures=False)
    run_scene(load_scene(path), tmp_path / "whole", engine=SERIAL, figures=False)
    assert_same_results(out, tmp_path / "whole")


@pytest.mark.slow
def test_workers_that_come_and_go(tmp_path):
    """One is added in the middle, and the first is killed with what it has done and not handed over."""
    path, out, file = long_scene(tmp_path, 600), tmp_path / "out", tmp_path / "scheduler.json"
    with cluster(file) as (_, first, another):
        process = of_cluster(path, out, file)
        another()
        os.killpg(first.pid, signal.SIGKILL)
        _, error = process.communicate(timeout=120)
    assert process.returncode == 0
    # Where the second is not there yet when the first is gone.
    assert error == "" or re.fullmatch(r"the cluster has no worker; waiting for one, for .* at most\n", error)
    run_scene(load_scene(path), tmp_path / "whole", engine=SERIAL, figures=False)
    assert_same_results(out, tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.parametrize(
    "worker, words", [("without", "No module named 'surveysim'"), ("another", "surveysim 0.0.0; ")]
)
def test_workers_that_can_not_do_the_work(tmp_path, worker, words):
    """One that does not have the program, or another version: a line, and no endless wait."""
    file, place = tmp_path / "scheduler.json", tmp_path / "elsewhere"
    place.mkdir()
    if worker == "another":
        for name in ("surveysim", "mapmaker"):
            shutil.copytree(ROOT / name, place / name, ignore=shutil.ignore_patterns("__pycache__"))
        text = (place / "surveysim" / "__init__.py").read_text()
        (place / "surveysim" / "__init__.py").write_text(text.replace(f'"{__version__}"', '"0.0.0"'))
    else:
        (place / "sitecustomize.py").write_text(HIDDEN)
    with cluster(file, worker_path=place):
        process = start("run", long_scene(tmp_path, 20), "--out", tmp_path / "out", *DASK, file, "--no-figures", "-q")
        _, error = process.communicate(timeout=60)
    # The command may begin before the worker has joined.
    lines = [line for line in error.splitlines() if not line.startswith("the cluster has no worker; waiting for one")]
    assert process.returncode == 1 and len(lines) == 1 and words in lines[0]


@pytest.mark.slow
def test_a_scheduler_that_falls_silent(tmp_path):
    """A stopped process: the run hears a request to stop, keeps what is done, and ends soon."""
    path, out, file = long_scene(tmp_path, 2000), tmp_path / "out", tmp_path / "scheduler.json"
    with cluster(file) as (scheduler, _, _):
        process = of_cluster(path, out, file)
        scheduler.send_signal(signal.SIGSTOP)
        time.sleep(3)
        process.send_signal(signal.SIGTERM)
        _, error = process.communicate(timeout=20)
    assert (process.returncode, error) == (130, f"interrupted; go on with: {resuming(process)}\n")
