"""Sweeps of cameras of several bands: over keys of one band and of all."""

import json
from pathlib import Path

import pytest
from astropy.table import QTable

import surveysim
from surveysim import load_band_sweep, run_sweep
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.errors import SceneError
from surveysim.studies.sweep.bands import sweep_points
from tests.cameras import TWO_BANDS, write_camera

PITCH, SPEED = "bands.150.instrument.layout.pitch_f_lambda", "scan.speed"
SWEEP = f'\n[sweep]\n"{PITCH}" = [0.7, 1.4]\n"{SPEED}" = ["4 arcmin / s", "5 arcmin / s"]\n'


def sweep_file(folder, sweep=SWEEP):
    return write_camera(folder, TWO_BANDS + sweep)


def test_bands_have_the_axes_that_concern_them(tmp_path):
    sweep = load_band_sweep(sweep_file(tmp_path))
    assert {name: [axis.name for axis in item.axes] for name, item in sweep.bands.items()} == {
        "150": [PITCH, SPEED],
        "220": [SPEED],
    }
    assert len(sweep_points(sweep)) == 6
    wide, narrow = (item.points for item in sweep.bands.values())
    assert [point.scene.instrument.layout.pitch_f_lambda for point in wide] == [0.7, 0.7, 1.4, 1.4]
    assert len({point.scene.scan.speed_rad_s for point in narrow}) == 2
    assert [point.scene.band_name for point in (*wide, *narrow)] == ["150"] * 4 + ["220"] * 2


@pytest.mark.parametrize(
    "text, bands",
    [
        ('"detector.psd" = ["1 mK2/Hz", "2 mK2/Hz"]', ["150"]),  # the other band has its own
        ('"bands.220.detector.psd" = ["1 mK2/Hz", "2 mK2/Hz"]', ["220"]),
        ('[sweep.both]\n"bands.150.photon.psd" = ["1 mK2/Hz"]\n"bands.220.photon.psd" = ["2 mK2/Hz"]', ["150", "220"]),
    ],
)
def test_bands_that_no_axis_concerns_are_left_out(tmp_path, text, bands):
    sweep = load_band_sweep(sweep_file(tmp_path, f"\n[sweep]\n{text}\n"))
    assert list(sweep.bands) == bands


def test_subtracted_bands_concern_those_that_subtract_them(tmp_path):
    text = TWO_BANDS.replace('"average"', '["average", "spectral"]').replace("rings = 1", "rings = 2\ndead = [5]")
    path = write_camera(tmp_path, text + '\n[sweep]\n"bands.220.detector.psd" = ["1 mK2/Hz", "2 mK2/Hz"]\n')
    assert list(load_band_sweep(path).bands) == ["150", "220"]


@pytest.mark.parametrize(
    "text, line",
    [
        (
            '"bands.150.scan.speed" = [1, 2]',
            "sweep.bands.150.scan.speed: 'scan' is the same in all bands; 'scan.speed'",
        ),
        (
            '"bands.150.detector.psdd" = [1, 2]',
            "sweep.bands.150.detector.psdd: unknown key; did you mean detector.psd?",
        ),
        ('"bands.90.detector.psd" = [1, 2]', "sweep.bands.90.detector.psd: unknown key"),
        (
            '"bands.150.instrument.layout.dead" = [[40], []]',
            "point (bands.150.instrument.layout.dead = [40]): bands.150.instrument.layout.dead: found [40]; different",
        ),
        ('"bands.150.detector.psd" = ["x"]', "point (bands.150.detector.psd = x): bands.150.detector.psd: found 'x'"),
    ],
)
def test_refused(tmp_path, text, line):
    path = sweep_file(tmp_path, f"\n[sweep]\n{text}\n")
    with pytest.raises(SceneError) as caught:
        load_band_sweep(path)
    assert str(caught.value).startswith(f"{path}: {line}") and "\n" not in str(caught.value)


@pytest.mark.slow
def test_a_run_and_a_forecast(tmp_path):
    path, out = sweep_file(tmp_path), tmp_path / "out"
    result = run_sweep(path, out, engine=SERIAL, figures=False)
    assert list(result.bands) == ["150", "220"]
    summary, table = json.loads((out / "summary.json").read_text()), QTable.read(out / "bands.ecsv")
    assert table["points"].tolist() == [4, 2] and table["band"].astype(str).tolist() == ["150", "220"]
    for name, item in result.bands.items():
        own = json.loads((out / "bands" / name / "summary.json").read_text())
        assert len(own["points"]) == len(item.points) and own["scene"] == f"two_{name}"
        best = own["points"][own["best"][0]]
        entry = summary["bands"][name]
        assert (entry["best"], entry["sigma_ukcmb2"]) == (best["label"], best["scores"]["actual"]["sigma_ukcmb2"])
        assert not (out / "bands" / name / "scene.toml").exists()
    assert 'href="bands/220/report.html"' in (out / "report.html").read_text()
    expected = surveysim.forecast_sweep(out / "scene.toml", tmp_path / "forecast", figures=False)
    assert [len(item.points) for item in expected.bands.values()] == [4, 2]
    assert (tmp_path / "forecast" / "bands" / "150" / "sweep.ecsv").is_file()
    points = surveysim.run_sweep(load_band_sweep(path).bands["220"], engine=SERIAL).points
    for alone, both in zip(points, result.bands["220"].points, strict=True):
        assert alone.scores["actual"].band.sigma_ukcmb2 == both.scores["actual"].band.sigma_ukcmb2


@pytest.mark.parametrize("after", [1, pytest.param(5, marks=pytest.mark.slow)])
def test_an_interrupted_sweep_is_resumed(call, tmp_path, monkeypatch, after):
    """In the first band, and in the second, whose first band is finished."""
    monkeypatch.chdir(tmp_path)
    path, quick = sweep_file(Path()), ("--engine", "serial", "--no-figures", "-q", "--out", "out")
    seen = []

    def stopping(show):
        def progress(done):
            seen.append(done)
            if len(seen) > after:
                raise KeyboardInterrupt
            show(done)

        return progress

    with monkeypatch.context() as patch:
        patch.setattr("surveysim.cli.progress.stopping", stopping)
        code, _, error = call("run", path, *quick)
    assert code == 130 and error.startswith("interrupted; go on with: surveysim run two.toml")
    assert call("run", path, *quick, "--resume") == (0, "", "")
    bands = json.loads(Path("out/summary.json").read_text())["bands"]
    whole = run_sweep(path, "whole", engine=SERIAL, figures=False)
    for name, entry in json.loads(Path("whole/summary.json").read_text())["bands"].items():
        assert bands[name] == entry
        files = [Path(folder, "bands", name, "sweep.ecsv").read_bytes() for folder in ("out", "whole")]
        assert files[0] == files[1]
    assert len(whole.bands) == 2


def test_check_and_plan(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = sweep_file(Path())
    code, out, error = call("check", path)
    first, *warnings = out.splitlines()
    assert (code, error, first) == (0, "", "two.toml: 'two' is a sweep of 6 points that can be run")
    assert any(line.startswith("Warning: 220: scan.speed = 4 arcmin / s: scan.sample_rate: ") for line in warnings)
    code, out, _ = call("plan", path, "--workers", 1)
    assert code == 0 and "two_150: 4 points" in out and "all 2 bands, one after another: about" in out
