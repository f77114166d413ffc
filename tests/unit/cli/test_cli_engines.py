"""The command line's engines: wrong choices, schedulers and disks in one line, and what was there stays."""

import json
import sys

import pytest

from tests.unit.cli.test_cli import refused
from tests.unit.survey.test_interruption import files


@pytest.fixture
def scene(scene_file):
    return scene_file


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--engine", "threads"), "--engine: found 'threads'; serial, processes, dask are there"),
        (("--scheduler", "tcp://host:8786"), "--scheduler: found one for the engine 'processes'; only 'dask' has one"),
        (
            ("--engine", "dask", "--scheduler", "tcp://host:8786", "--workers", 2),
            "--workers: found a number and a scheduler, which has workers of its own",
        ),
        *(
            (("--engine", "dask", "--scheduler", address), f"--scheduler: found {words}")
            for address, words in (
                ("tcp://", "'tcp://'; tcp://host:port, tls://host:port or a scheduler's file is expected"),
                ("nonsense", "'nonsense', which is neither an address nor a scheduler's file"),
                ("http://host:8786", "the protocol 'http'"),
                ("tcp://host:99999", "'tcp://host:99999' ("),
                ("", "'', which is neither"),
            )
        ),
    ],
)
def test_wrong_choices(call, scene, arguments, words):
    assert words in refused(call, scene, *arguments)


def test_a_scheduler_that_is_not_there_costs_nothing(call, scene, monkeypatch):
    """Neither the time of a run nor the results of an earlier one; a wrong address is the user's error."""
    monkeypatch.setattr("surveysim.runtime.dask_scheduler.CONNECT_S", 0.5)
    out = scene.parent / "out"
    assert call("run", scene, "--out", out, "--engine", "serial", "--no-figures", "-q")[0] == 0
    before = {name: (out / name).read_bytes() for name in files(out) if (out / name).is_file()}
    assert json.loads(before["summary.json"])["run"]["engine"] == "serial"
    nowhere = scene.parent / "nowhere.json"
    for address, wanted, words in (
        (nowhere, 2, f"--scheduler: found '{nowhere}'"[:100]),
        ("tcp://127.0.0.1:9", 1, "scheduler: no scheduler answers at tcp://127.0.0.1:9"),
    ):
        code, _, error = call("run", scene, "--out", out, "--engine", "dask", "--scheduler", address)
        assert code == wanted and len(error.splitlines()) == 1 and error.startswith(words)
    assert {name: (out / name).read_bytes() for name in files(out) if (out / name).is_file()} == before


def test_without_distributed(call, scene, monkeypatch):
    """The extra is named that brings it."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "surveysim.runtime.dask_cluster", raising=False)
    code, _, error = call("run", scene, "--out", scene.parent / "out", "--engine", "dask", "-q")
    assert (code, error) == (1, "engine 'dask': distributed is not installed; in the clone: pip install '.[cluster]'\n")
