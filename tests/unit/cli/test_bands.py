"""Cameras of several bands from the command line: every band a run of its own, and a table and a page of all."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from astropy.table import QTable

import surveysim
from surveysim import load_bands, run
from surveysim.api.surveys import run_survey
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import NotForecastableError, SceneError
from surveysim.scene.shipped import shipped_folder
from tests.cameras import TWO_BANDS, write_camera
from tests.scenes import write_scene
from tests.trees import files

QUICK = ("--engine", "serial", "--no-figures", "-q")
NAMES = ("150", "220")
# Their bytes hold times, versions of the record or the place of the run.
TIMED = re.compile(r"summary\.json|report\.html|\.surveysim\.json|checkpoint\.h5")


@pytest.fixture
def camera(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return write_camera(Path(), TWO_BANDS)


def results(directory):
    """Hashes of the results below a directory that equal runs have in common."""
    found = files(Path(directory))
    return {name: content for name, content in found.items() if not TIMED.fullmatch(Path(name).name)}


def test_a_run_writes_each_band_and_a_table_of_all(call, camera):
    code, out, error = call("run", camera, "--engine", "serial", "--no-figures")
    assert code == 0 and "2 bands in" in out and "Results in outputs/two, with a page for each band behind" in out
    assert "two_150: 4/4 observations" in error and "two_220: 4/4 observations" in error
    top = Path("outputs/two")
    assert sorted(path.name for path in top.iterdir() if path.name[0] != ".") == [
        "bands",
        "bands.ecsv",
        "report.html",
        "scene.toml",
        "summary.json",
    ]
    summary, table = json.loads((top / "summary.json").read_text()), QTable.read(top / "bands.ecsv")
    assert summary["files"] == ["bands.ecsv", "report.html"] and list(summary["bands"]) == list(NAMES)
    assert table["band"].astype(str).tolist() == list(NAMES) and table["n_det"].tolist() == [18, 6]
    assert table["frequency"].to_value("GHz") == pytest.approx([150, 220])
    for name, row in zip(NAMES, table, strict=True):
        own = json.loads((top / "bands" / name / "summary.json").read_text())
        assert own["scene"] == f"two_{name}" and own["title"] == f"A small camera over a small field: {name}"
        score, entry = own["scores"]["actual"], summary["bands"][name]
        assert entry["sigma_ukcmb2"] == score["sigma_ukcmb2"] == row["sigma_ukcmb2"].to_value("uK2")
        assert entry["error_ukcmb2"] == score["error_ukcmb2"] == row["error_ukcmb2"].to_value("uK2")
        assert entry["detectors"] == own["detectors"] and entry["observations"] == own["observations"] == 4
        assert json.loads((top / "bands" / name / "scene.json").read_text())["band"] == name
        assert (top / "bands" / name / "report.html").is_file()
    page = (top / "report.html").read_text()
    assert all(f'<a href="bands/{name}/report.html">{name}</a>' in page for name in NAMES)
    for file in (top / "report.html", top / "bands/150/report.html"):
        file.unlink()
    assert call("report", top)[0] == 0
    assert (top / "report.html").read_text() == page and "<html" in (top / "bands/150/report.html").read_text()


def test_bands_are_their_own_runs_bit_for_bit(camera):
    scenes = load_bands(camera)
    both = run(camera, engine=SERIAL)
    for name, scene in scenes.bands.items():
        alone = run_survey(scene, engine=SERIAL)
        for key in ("sums", "weight", "hits", "flipped", "signal_maps"):
            np.testing.assert_array_equal(getattr(both.bands[name].coadds, key), getattr(alone.coadds, key))
        assert both.bands[name].scores["actual"].band.sigma_ukcmb2 == alone.scores["actual"].band.sigma_ukcmb2
    assert both.table()["n_det"].tolist() == [18, 6]
    assert repr(both).startswith("MultiBandResult of two: 2 bands\nband") and "<table>" in both._repr_html_()


def interrupt(monkeypatch, after):
    """Interrupt the program after a number of observations of all bands."""
    from surveysim.cli import bands

    seen = []

    def stopping(show):
        def progress(sums):
            seen.append(sums.done)
            if len(seen) > after:
                raise KeyboardInterrupt
            show(sums)

        return progress

    monkeypatch.setattr(bands, "stopping", stopping)


@pytest.mark.parametrize("after", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_an_interrupted_run_is_resumed(call, camera, monkeypatch, after):
    """In the first band, and in the second: the same files as of a run that never stopped."""
    assert call("run", camera, *QUICK, "--out", "whole") == (0, "", "")
    with monkeypatch.context() as patch:
        interrupt(patch, after)
        code, _, error = call("run", camera, *QUICK, "--out", "out")
    hint = f"surveysim run {camera} --engine serial --no-figures -q --out out --resume"
    assert code == 130 and error == f"interrupted; go on with: {hint}\n"
    code, _, error = call("run", camera, *QUICK, "--out", "out")
    assert (
        code == 2 and error.endswith("--out writes elsewhere\n") and "checkpoint.h5: from a run that has not" in error
    )
    assert call("run", camera, *QUICK, "--out", "out", "--resume") == (0, "", "")
    assert results("out") == results("whole")
    said = "out: the run is finished; there is nothing to resume\n"
    assert call("run", camera, *QUICK, "--out", "out", "--resume") == (0, "", said)
    assert call("run", camera, *QUICK, "--out", "out", "--set", "observations=8", "--resume") == (0, "", "")
    assert json.loads(Path("out/summary.json").read_text())["bands"]["220"]["observations"] == 8


def test_other_results_are_not_replaced(call, camera):
    assert call("run", camera, *QUICK, "--out", "out") == (0, "", "")
    before = files(Path("out"))
    code, _, error = call("run", camera, *QUICK, "--out", "out", "--set", "bands.150.detector.psd=9 mK2 / Hz")
    assert code == 2 and error == (
        "out: holds results of 'two' with other settings; --force replaces them, --out writes elsewhere\n"
    )
    assert files(Path("out")) == before
    settings = ("--set", "bands.150.detector.psd=9 mK2 / Hz")
    assert call("run", camera, *QUICK, "--out", "out", *settings, "--force") == (0, "", "")
    copy = Path("out/scene.toml").read_text()
    assert 'psd = "9 mK2 / Hz"' in copy
    assert call("run", "out/scene.toml", *QUICK, "--out", "again") == (0, "", "")
    assert results("again") == results("out")


def test_a_target_and_a_budget_stop_each_band(camera):
    settings = {"observations": 64, "score.jackknives": 32}
    stopped = run(load_bands(camera, settings), engine=SERIAL, target_error=0.9)
    assert [item.stopped for item in stopped.bands.values()] == ["target", "target"]
    assert not stopped.is_whole
    spent = run(load_bands(camera, settings), engine=SERIAL, time_budget_s=1e-3)
    assert [(item.stopped, item.coadds.done) for item in spent.bands.values()] == [("budget", 2), ("budget", 2)]
    with pytest.raises(SceneError, match="two.toml: score: missing; a target error is one of"):
        run(load_bands(camera, {"score": None}), engine=SERIAL, target_error=0.1)


def test_check_forecast_and_plan(call, camera):
    code, out, _ = call("check", camera)
    assert code == 0 and out.splitlines()[:3] == [
        "two.toml: 'two' is a camera of 2 bands that can be run",
        "150: 18 detectors; 1 dead position of 19",
        "220: 6 detectors; 1 dead position of 7",
    ]
    assert "Warning: 220: map.pixel: pixels of 30 arcsec are larger than half of the beam" in out
    assert "Warning: 150: map.pixel" not in out
    code, out, _ = call("forecast", camera, "--out", "forecast")
    assert code == 0 and "A small camera over a small field: forecast of the uncertainty" in out
    table = QTable.read("forecast/bands.ecsv")
    found = surveysim.forecast(camera)
    assert table["sigma_ukcmb2"].to_value("uK2") == pytest.approx(found.table()["sigma_ukcmb2"].to_value("uK2"))
    assert sorted(found.bands) == list(NAMES) and Path("forecast/bands/220/forecast.ecsv").is_file()
    code, out, _ = call("plan", camera, "--workers", 1)
    assert code == 0 and "all 2 bands, one after another: about" in out and "two_150" in out and "two_220" in out


def test_bands_without_a_forecast(call, camera):
    local = {"bands.150.cleaning.algorithm": "local", "bands.150.cleaning.neighbour_radius": 2}
    found = surveysim.forecast(load_bands(camera, local))
    assert list(found.bands) == ["220"] and "local" in found.reasons["150"]
    settings = [word for key, value in local.items() for word in ("--set", f"{key}={value}")]
    code, out, _ = call("forecast", camera, *settings)
    assert code == 0 and "No forecast: 150: " in out
    with pytest.raises(NotForecastableError, match=r"^bands.150: .*; bands.220: "):
        surveysim.forecast(load_bands(camera, {"score": None}))


@pytest.mark.parametrize("command", ["check", "run", "forecast", "plan"])
def test_errors_name_the_band(call, camera, command):
    """Of the schema, and of what only a camera that is made can tell."""
    for setting, line in (
        ("bands.150.instrument.frequency=3 m", "bands.150.instrument.frequency: found '3 m'; a quantity in"),
        ("bands.220.instrument.layout.dead=[40]", "bands.220.instrument.layout.dead: found [40]; different numbers"),
    ):
        code, out, error = call(command, camera, "--set", setting)
        assert (code, out) == (2, "") and error.startswith(f"two.toml: {line}") and error.count("\n") == 1
    assert not Path("outputs").exists()


@pytest.mark.parametrize("arguments", [("accuracy", "two.toml"), ("accuracy", "two.toml", "--quiet")])
def test_commands_on_scenes_of_one_band(call, camera, arguments):
    assert call(*arguments) == (
        2,
        "",
        "two.toml: bands: found a camera of several bands; a scene without [bands] is expected here\n",
    )


def test_a_shipped_camera_with_its_tables(call, camera):
    """1,509 positions of a table at a place of its own: counts and passband by an independent reading."""
    table = QTable.read(shipped_folder() / "three_bands_detectors.ecsv")
    code, out, _ = call("new", "mine", "--like", "three_bands")
    assert code == 0 and "with three_bands_detectors.ecsv, three_bands_150.ecsv in the same folder" in out
    code, out, _ = call("check", "mine")
    counts = {name: np.count_nonzero((table["band"] == name) & (table["dead"] == 0)) for name in ("90", "150", "220")}
    assert code == 0 and len(table) == 1509
    for name, live in counts.items():
        there = np.count_nonzero(table["band"] == name)
        assert f"{name}: {live} detectors; {there - live} dead positions of {there}\n" in out
    setups = {name: prepare(scene) for name, scene in load_bands("mine").bands.items()}
    for name, setup in setups.items():
        own = table[(table["band"] == name) & (table["dead"] == 0)]
        nep = own["nep"].to_value("W / Hz(1/2)")
        np.testing.assert_allclose(setup.camera.properties.noise, nep**2 / np.mean(nep**2), rtol=1e-6)
    curve = QTable.read(shipped_folder() / "three_bands_150.ecsv")
    fine = np.linspace(124, 176, 200_001)
    weight = np.interp(fine, curve["frequency"].to_value("GHz"), curve["transmission"])
    centre = setups["150"].scene.instrument.band.centre_hz / 1e9
    assert centre == pytest.approx(np.average(fine, weights=weight), rel=1e-6)
    assert call("new", "other", "--like", "three_bands")[0] == 0  # the same tables
    Path("scenarios/three_bands_150.ecsv").write_text("")
    code, _, error = call("new", "third", "--like", "three_bands")
    assert code == 2 and "three_bands_150.ecsv: exists, with another content than" in error
    assert not Path("scenarios/third.toml").exists()


def test_force_replaces_bands_that_are_gone(call, camera):
    """Of a camera, or of a scene of one band in its place; files of the user stay."""
    assert call("run", camera, *QUICK, "--out", "out") == (0, "", "")
    Path("out/bands/150/notes.txt").write_text("mine")
    camera.write_text(TWO_BANDS.replace("bands.220", "bands.230"))
    assert call("run", camera, *QUICK, "--out", "out", "--force") == (0, "", "")
    assert sorted(path.name for path in Path("out/bands").iterdir()) == ["150", "230"]
    assert call("run", write_scene(Path()), *QUICK, "--out", "out", "--force") == (0, "", "")
    assert [path.relative_to("out").as_posix() for path in Path("out/bands").rglob("*")] == [
        "bands/150",
        "bands/150/notes.txt",
    ]
    assert not Path("out/bands.ecsv").exists() and Path("out/maps/actual.fits").is_file()
