"""Finished runs beside each other: pairs, settings that differ, files, and directories that are refused."""

import json
import shutil

import numpy as np
import pytest
from astropy.table import Table

import surveysim
from surveysim import SceneError, compare, load_scene, run, run_sweep
from surveysim.output.lock import OutputError
from surveysim.output.record import RECORD
from surveysim.report.html.page import write_report
from surveysim.runtime.engine import SERIAL
from surveysim.studies.compare.differences import differences
from surveysim.studies.compare.finished_run import run_labels
from tests.pages import read_page, rows_of
from tests.unit.studies.test_sweep_run import SPEEDS, WHITE

SIGMA = ("actual", "flat_band_power.sigma")
METRIC = '\n[[score.metrics]]\nkind = "largest_scale"\n'


@pytest.fixture(scope="module")
def sweep(write, tmp_path_factory):
    """A finished sweep of the scan speed and where its files are."""
    out = tmp_path_factory.mktemp("speeds")
    return run_sweep(write(WHITE + METRIC + SPEEDS), out, engine=SERIAL, figures=False), out


@pytest.fixture(scope="module")
def alone(write, tmp_path_factory):
    """Directories of the scene of the sweep's second point, with its seed and with another."""
    folder, path = tmp_path_factory.mktemp("runs"), write(WHITE + METRIC)
    for seed in (11, 12):
        run(load_scene(path, {"seed": seed}), folder / f"seed{seed}", engine=SERIAL, figures=False)
    return folder / "seed11", folder / "seed12"


def test_points_of_a_sweep_have_its_paired_errors(sweep):
    result, out = sweep
    found = compare([out / "points" / str(number) for number in range(3)])
    comparison = found.quantities[SIGMA]
    for name in ("value", "error", "ratio", "paired_error", "independent_error", "best_probability"):
        np.testing.assert_array_equal(getattr(comparison, name), getattr(result.comparison, name))
    assert found.differences == {"scan.speed": ["3 arcmin / s", "4 arcmin / s", "5 arcmin / s"]}
    assert found.groups == ((0, 1, 2),) and found.unpaired(2) == ""
    scale = found.quantities["actual", "largest_scale.ell"]
    assert np.isfinite(scale.ratio).all() and (scale.paired_error[1:] <= scale.independent_error[1:] + 1e-12).all()


def test_a_run_of_the_same_scene_is_equal(sweep, alone):
    """A point and the run of its scene have all in common, so their ratio has no error; another seed has nothing."""
    found = compare([sweep[1] / "points" / "1", *alone])
    comparison = found.quantities[SIGMA]
    assert comparison.ratio[1] == 1 and comparison.paired_error[1] == 0 and comparison.independent_error[1] > 0
    relative = comparison.error / comparison.value
    independent = comparison.ratio[2] * np.hypot(relative[0], relative[2])
    assert comparison.paired_error[2] == pytest.approx(independent, rel=1e-12)
    assert found.groups == ((0, 1), (2,)) and found.unpaired(2) == "seeds 11 and 12"
    assert found.differences == {"seed": ["11", "11", "12"]}


def test_directories_without_scores(sweep, alone, tmp_path):
    """Those of earlier versions, damaged ones and those of another run are compared as independent."""
    for name, content in (("old", None), ("damaged", b"no zip"), ("other", (alone[1] / "scores.npz").read_bytes())):
        shutil.copytree(alone[0], tmp_path / name)
        (tmp_path / name / "scores.npz").unlink()
        if content:
            (tmp_path / name / "scores.npz").write_bytes(content)
    names = ("old", "damaged", "other")
    found = compare([alone[0], *(tmp_path / name for name in names)])
    comparison = found.quantities[SIGMA]
    assert comparison.ratio.tolist() == [1.0] * 4
    np.testing.assert_allclose(comparison.paired_error[1:], comparison.independent_error[1:], rtol=1e-12)
    assert (comparison.paired_error[1:] > 0).all()
    assert ("actual", "largest_scale.ell") not in found.quantities
    assert found.unpaired(1) == "its directory has no scores.npz, which runs of surveysim 0.7 and later write"
    assert "damaged" in found.unpaired(2) and found.unpaired(3) == "its scores.npz is of another run"


@pytest.mark.parametrize(
    "change",
    [
        {"actual/noise_psds": lambda found: found[:, :2]},
        {"actual/weights": lambda found: found[:1]},
        {"actual/weights": lambda found: found.astype(str)},
        {"actual/signal_psd": lambda found: found[:1]},
        {"actual/transfer_function.deviations": lambda found: found[0]},
        {"actual/bin_noise": lambda found: found[..., None]},
        {"actual/noise_psds": lambda found: found * np.nan},
        {"actual/metrics/largest_scale.ell/quoted.noise": lambda found: found[:1]},
    ],
    ids=lambda change: next(iter(change)),
)
def test_arrays_that_do_not_fit_are_damage(alone, tmp_path, change):
    shutil.copytree(alone[0], tmp_path / "changed")
    with np.load(tmp_path / "changed" / "scores.npz") as file:
        content = dict(file)
    content |= {name: do(content[name]) for name, do in change.items()}
    np.savez(tmp_path / "changed" / "scores.npz", **content)
    assert "damaged (" in compare([alone[0], tmp_path / "changed"]).unpaired(1)


def test_other_versions_are_independent(alone, tmp_path, monkeypatch):
    """Random numbers of versions may differ."""
    shutil.copytree(alone[0], tmp_path / "later")
    summary = json.loads((tmp_path / "later" / "summary.json").read_text())
    (tmp_path / "later" / "summary.json").write_text(json.dumps(summary | {"surveysim": "9.9.9"}))
    with np.load(tmp_path / "later" / "scores.npz") as file:
        content = dict(file)
    meta = json.loads(str(content.pop("meta"))) | {"version": "9.9.9"}
    np.savez(tmp_path / "later" / "scores.npz", meta=json.dumps(meta), **content)
    found = compare([alone[0], tmp_path / "later"])
    assert found.unpaired(1) == f"versions {surveysim.__version__} and 9.9.9, whose random numbers may differ"
    assert found.quantities[SIGMA].paired_error[1] > 0


# ---------------------------------------------------------------- files


def test_files_of_a_comparison(sweep, alone, tmp_path):
    runs = [sweep[1] / "points" / "1", sweep[1] / "points" / "2", alone[1]]
    result = compare(runs, tmp_path / "out")
    out = tmp_path / "out"
    there = {path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()}
    drawn = {f"figures/{name}.png" for name in ("map_psd", "transfer_function", "timestream_psd")}
    assert there == {RECORD, "report.html", "summary.json", "tables/compare.ecsv", *drawn}
    table = Table.read(out / "tables" / "compare.ecsv")
    own = table[(table["data_set"] == "actual") & (table["quantity"] == SIGMA[1])]
    np.testing.assert_array_equal(own["ratio"], result.quantities[SIGMA].ratio)
    assert list(own["errors"]) == ["paired", "paired", "independent"] and own["unit"][0] == "uK2"
    page = read_page(out / "report.html")
    assert [row[0].text for row in rows_of(page, "settings-table")] == ["scan.speed", "seed"]
    assert "independent runs: seeds 11 and 12." in page.one("main").text
    before = (out / "report.html").read_bytes()
    write_report(out)
    assert (out / "report.html").read_bytes() == before
    assert "RunComparison of 3 runs" in repr(result) and result.table()["value"].shape == (len(table),)
    with pytest.raises(OutputError, match="holds results of 'surveysim run'"):
        compare(runs, alone[1])


def test_labels_tell_runs_apart(tmp_path):
    runs = [tmp_path / name for name in ("a/points/1", "a/points/2")]
    assert run_labels(runs) == ["points/1", "points/2"]
    assert run_labels([tmp_path / "a", tmp_path / "b" / "points" / "3"]) == ["a", "b/points/3"]
    assert run_labels([tmp_path / "a", tmp_path / "a" / "points" / "3"]) == ["a", "points/3"]


def test_settings_are_told_by_their_keys():
    """As in the file where it has them, else the resolved value with its unit; tables of a list by number."""
    scenes = [
        {"title": "a", "scan": {"speed_rad_s": 0.5, "scans": 3}, "sky": {"point_sources": [{"peak_mk": 1.0}]}},
        {"title": "b", "scan": {"speed_rad_s": 1.0, "scans": 3, "dither_rad": 0.25}, "sky": None},
    ]
    settings = [{"scan": {"speed": "1 deg / s"}}, {}]
    assert differences(scenes, settings) == {
        "scan.speed": ["1 deg / s", "57.2958 deg / s"],
        "sky.point_sources[0].peak": ["1 mk", "none"],
        "scan.dither": ["none", "14.3239 deg"],
    }


# ---------------------------------------------------------------- what is refused


@pytest.mark.parametrize(
    "name, line",
    [
        (
            "gone",
            "no such directory; the directory of a run, or of a point of a sweep as in SWEEP/points/3, is expected",
        ),
        ("file", "not a directory; the directory of a run"),
        ("empty", "found no results; the directory of a run"),
        ("sweep", "found a sweep; the directory of a run, or of a point of a sweep as in SWEEP/points/3, is expected"),
        ("bands", "found a camera of several bands; the directory of a band, as in DIR/bands/150, is expected"),
        ("unscored", "found a run without a score (too few); one with a score is expected"),
        ("paper", "found other results; the directory of a run"),
        ("broken", "can't be read"),
        ("damaged", "damaged (scores.actual.sigma_ukcmb2: Input should be greater than 0); the directory of a run"),
    ],
)
def test_other_directories_are_refused(alone, tmp_path, name, line):
    path = tmp_path / name
    contents = {
        "sweep": {"points": []},
        "bands": {"bands": {}},
        "unscored": {"scores": {}, "seed": 1, "unscored": "too few"},
        "paper": {"paper": "", "runs": []},
    }
    summary = json.loads((alone[0] / "summary.json").read_text())
    summary["scores"]["actual"]["sigma_ukcmb2"] = -1.0
    contents["damaged"] = summary
    if name == "file":
        path.write_text("mine")
    elif name != "gone":
        path.mkdir()
    if name in contents:
        (path / "summary.json").write_text(json.dumps(contents[name]))
    if name == "broken":
        (path / "summary.json").write_text("{")
    with pytest.raises(SceneError) as caught:
        compare([alone[0], path])
    text = str(caught.value)
    assert text.startswith(f"{path}") and line in text and "\n" not in text


def test_two_different_directories_are_needed(alone):
    with pytest.raises(SceneError, match="compare: found 1 directory; two or more are expected"):
        compare([alone[0]])
    with pytest.raises(SceneError, match="found twice; different directories are expected"):
        compare([alone[0], alone[0] / "."])
