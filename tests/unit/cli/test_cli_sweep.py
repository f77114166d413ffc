"""The command line on sweeps and forecasts."""

import os
import shutil
import signal
from pathlib import Path

import numpy as np
import pytest
from astropy.table import Table

from tests.scenes import SMALL_SCENE, TURBULENT_SCENE, without_sections
from tests.unit.cli.test_cli import refused
from tests.unit.survey.test_interruption import none_left, resuming, start, wait_for

FORECAST_FILES = [".surveysim.json", "report.html", "scene.json", "scene.toml", "summary.json", "sweep.ecsv"]
FILES = [*FORECAST_FILES, "sweep_pairs.ecsv"]
SWEEP = '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]\n'


@pytest.fixture
def scene(scene_file):
    return scene_file


@pytest.fixture
def sweep(tmp_path):
    path = tmp_path / "speeds.toml"
    path.write_text(TURBULENT_SCENE + SWEEP)
    return path


def test_check_and_plan_of_a_sweep(call, sweep):
    counted = "all points: 18 detectors; 1 dead position of 19"
    assert call("check", sweep) == (0, f"{sweep}: 'speeds' is a sweep of 2 points that can be run\n{counted}\n", "")
    code, out, error = call("check", sweep, "--set", "scan.speed=1 arcmin / s")
    assert (code, out) == (2, "") and error.startswith(f"{sweep}: scan.speed: set, and on an axis of the sweep")
    code, out, error = call("plan", sweep, "--workers", 1, "--set", "observations=2")
    assert (code, error) == (0, "")
    assert "speeds: 2 points" in out and "3 arcmin / s, 4 arcmin / s" in out and "MB a process" in out
    assert (
        "0.01728 million detector-samples" in out
    )  # 2 points of 2 observations of 4 scans of 60 samples, 18 detectors
    code, _, error = call("plan", sweep, "--set", "score.ell_max=30000")
    assert code == 2 and error.startswith(f"{sweep}: score.ell_max: found 30000") and len(error.splitlines()) == 1
    assert list(sweep.parent.iterdir()) == [sweep]


def test_sweeps_that_are_refused(call, sweep):
    assert "--save-timestreams: found a sweep, which keeps none" in refused(call, sweep, "--save-timestreams")
    assert "point (scan.speed = 4 arcmin" not in refused(call, sweep, "--set", "scan.scans=0")
    sweep.write_text(SMALL_SCENE + '\n[sweep]\n"scan.scans" = [0, 4]\n')
    assert f"{sweep}: point (scan.scans = 0): scan.scans: found 0" in refused(call, sweep)
    sweep.write_text(without_sections(SMALL_SCENE, "score") + SWEEP)
    assert f"{sweep}: score: missing; scenes are compared by their scores" in refused(call, sweep)


def test_run_of_a_sweep(call, sweep):
    out = sweep.parent / "out"
    arguments = ("--out", out, "--workers", 1, "--set", "observations=5")
    code, text, error = call("run", sweep, *arguments, "--resume", "--no-figures", "--verbose")
    assert code == 0 and "best: scan.speed = " in text and " with confidence " in text
    assert "Ratios are to scan.speed = 3 arcmin / s, with paired errors." in text
    lines = error.splitlines()
    assert lines[0] == f"no points in {out}: starting with the first"
    assert [line.split(",")[0] for line in lines[1:]] == ["speeds: 1/2 points", "speeds: 2/2 points"]
    assert sorted(path.name for path in out.iterdir()) == sorted(["points", *FILES])
    assert call("run", sweep, *arguments, "--quiet") == (0, "", "")
    assert (out / "figures" / "sweep.png").exists()
    shutil.rmtree(out / "points")
    (out / "points").write_text("mine")
    code, _, error = call("run", sweep, *arguments)
    assert code == 1 and f"{out / 'points'}: a file where a folder is to be written" in error


def test_one_point_of_a_sweep(call, sweep, monkeypatch):
    """A run of its own, with the numbers of the sweep's point and all that a run takes."""
    monkeypatch.chdir(sweep.parent)
    quick = ("--engine", "serial", "--no-figures", "-q")
    assert call("run", sweep, *quick, "--set", "observations=5", "--out", "whole") == (0, "", "")
    assert call("run", sweep, *quick, "--set", "observations=5", "--point", 1, "--save-timestreams") == (0, "", "")
    alone, point = Path("outputs/speeds+observations=5+point=1"), Path("whole/points/1")
    for name in ("scores", "map_psd", "observations", "timestream_psd"):
        assert (alone / f"tables/{name}.ecsv").read_bytes() == (point / f"tables/{name}.ecsv").read_bytes()
    assert len(list((alone / "timestreams").iterdir())) == 5 and (alone / "checkpoint.h5").is_file()
    code, text, _ = call("report", "whole")
    assert (code, text.split()) == (0, [f"whole/{name}report.html" for name in ("points/0/", "points/1/", "")])
    error = refused(call, sweep, "--point", 2)
    assert error == f"{sweep}: --point: found 2; the number of a point, 0 to 1, is expected\n"
    assert "--keep-all: found --point, whose run keeps all" in refused(call, sweep, "--point", 1, "--keep-all")
    error = refused(call, sweep, "--point", 1, "--reference", 0)
    assert error == "--reference: found --point, whose run has no ratios; one of the two is expected\n"
    sweep.write_text(SMALL_SCENE)
    assert "--point: found a scene without [sweep]; a sweep of one" in refused(call, sweep, "--point", 1)
    assert "--keep-all: found a scene without [sweep]; a sweep is" in refused(call, sweep, "--keep-all")


def test_limits_of_a_sweep(call, sweep):
    """With few observations there is one round."""
    out, limits = sweep.parent / "speeds", ("--target-error", "5%", "--confidence", "90%")
    code, text, error = call("run", sweep, *limits, "--engine", "serial", "--no-figures", "--out", out)
    assert code == 0 and "The sweep ended after 1 round, to 4 observations, 8 in all: " in text
    assert "speeds: 2/2 rounds of points, at most" in error
    assert "--confidence: found no --target-error; both are expected" in refused(call, sweep, "--confidence", "90%")
    error = refused(call, sweep, "--target-error", "3%", "--confidence", "2")
    assert error == "confidence: found 2; 50 % or more and less than 100 % is expected\n"
    assert "--target-error: found" in refused(call, sweep, "--target-error", "3 K")
    assert "--time-budget: found a sweep, whose points run to the end of a round" in refused(
        call, sweep, "--time-budget", "3 s"
    )
    sweep.write_text(SMALL_SCENE)
    error = refused(call, sweep, "--target-error", "3%", "--confidence", "90%")
    assert "--confidence: found a run of a scene; a sweep with --target-error is expected" in error


def test_reference_point_of_the_command_line(call, sweep):
    """By number, by its values; errors say what names a point."""
    out = sweep.parent / "out"
    for given in ("1", "scan.speed=4 arcmin / s"):
        code, text, _ = call("forecast", sweep, "--out", out, "--reference", given, "--no-figures", "-v")
        assert code == 0 and "Ratios are to scan.speed = 4 arcmin / s." in text
        assert Table.read(out / "sweep.ecsv", format="ascii.ecsv").meta["reference"] == 1
    for given, words in (("2", "found 2; the number of a point, 0 to 1, is expected"), ("x", "names no point; as in")):
        code, text, error = call("run", sweep, "--reference", given)
        assert (code, text) == (2, "") and f"{sweep}: --reference: " in error and words in error
    sweep.write_text(SMALL_SCENE)
    for command in ("run", "forecast"):
        code, _, error = call(command, sweep, "--reference", "0")
        assert (
            code == 2
            and error == f"{sweep}: --reference: found a scene without [sweep]; points of a sweep are expected\n"
        )


@pytest.mark.slow
def test_interrupted_sweep(sweep):
    """Ctrl-C in a terminal with workers: the hint, whole files of finished points, nobody left behind."""
    values = ", ".join(f'"{speed} arcmin / s"' for speed in np.linspace(3, 5, 30))
    sweep.write_text(f'{SMALL_SCENE}\n[sweep]\n"scan.speed" = [{values}]\n')
    out = sweep.parent / "out"
    process = start("run", sweep, "--out", out, "--workers", 2, "--no-figures", "-q")
    wait_for(out / "points" / "001.npz", process)
    os.killpg(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=20)
    assert (process.returncode, error) == (130, f"interrupted; go on with: {resuming(process)}\n")
    assert none_left(process.pid) and not list(out.rglob("*.part"))
    assert not (out / "sweep.ecsv").exists() and len(list((out / "points").glob("???.npz"))) >= 1


def test_forecast(call, scene):
    code, out, error = call("forecast", scene, "--verbose")
    assert (code, error) == (0, "") and "masked_7" in out and "Effects on the forecast" in out
    assert list(scene.parent.iterdir()) == [scene]
    assert call("forecast", scene, "--out", scene.parent / "out", "--quiet") == (0, "", "")
    table = Table.read(scene.parent / "out" / "forecast.ecsv", format="ascii.ecsv")
    assert {"ell", "noise_actual", "signal_actual", "noise_white"} <= set(table.colnames) and len(table) == 6
    code, out, error = call("forecast", scene, "--set", "score=x")
    assert code == 2 and "score: found 'x'; a section is expected" in error


def test_forecast_of_what_has_none(call, scene):
    scene.write_text(without_sections(SMALL_SCENE, "score"))
    code, out, error = call("forecast", scene)
    assert (code, out) == (2, "") and error.startswith(f"{scene}: score: missing") and len(error.splitlines()) == 1


def test_forecast_of_a_sweep(call, sweep, monkeypatch):
    monkeypatch.chdir(sweep.parent)
    code, out, error = call("forecast", sweep, "--no-figures")
    assert code == 0 and "best: scan.speed = 3 arcmin / s, sigma(A) = " in out and "by forecast" in out
    assert "confidence" not in out and error.splitlines()[-1].startswith("speeds: 2/2 points")
    directory = Path("outputs/speeds_forecast")
    assert sorted(path.name for path in directory.iterdir()) == FORECAST_FILES
    assert call("forecast", sweep, "--out", "mine", "--quiet") == (0, "", "")
    assert Path("mine/figures/sweep.png").exists()
