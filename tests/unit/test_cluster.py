"""Clusters whose scheduler and workers come and go: the same bits, or a checkpoint to go on from."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from surveysim import load_scene
from surveysim import run as run_scene
from surveysim.engines import SERIAL
from tests.unit.test_interruption import assert_same_results, long_scene, start, wait_for


@contextmanager
def cluster(file):
    """A scheduler with one worker, and a function that starts another; all are gone in the end."""
    crew = []

    def member(*arguments):
        command = [sys.executable, "-m", f"distributed.cli.dask_{arguments[0]}", *map(str, arguments[1:])]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
        crew.append(subprocess.Popen([*command, "--scheduler-file", file, "--no-dashboard"], **quiet))
        return crew[-1]

    try:
        scheduler = member("scheduler", "--host", "127.0.0.1", "--port", "0")
        wait_for(file, scheduler)
        yield scheduler, member("worker", "--nthreads", "1"), lambda: member("worker", "--nthreads", "1")
    finally:
        for each in crew:
            os.killpg(each.pid, signal.SIGKILL)
            each.wait()


def of_cluster(path, out, file):
    """A run on it, once some of it is kept."""
    choice = ("--engine", "dask", "--scheduler", file)
    process = start("run", path, "--out", out, *choice, "--no-figures", "-q", fast=True)
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
    assert error == f"the scheduler of the cluster is gone; go on with --resume --out {out}\n"
    assert [item.name for item in out.iterdir()] == ["checkpoint.h5"]
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
    assert (process.returncode, error) == (0, "")
    run_scene(load_scene(path), tmp_path / "whole", engine=SERIAL, figures=False)
    assert_same_results(out, tmp_path / "whole")
