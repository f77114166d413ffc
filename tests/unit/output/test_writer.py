"""Files that others can read: strict JSON, safe names, figures that may fail, disks that fill up."""

import errno
import json
import math
import os
import resource
import stat
import warnings
from dataclasses import replace

import numpy as np
import pytest

from mapmaker.files import atomic_write
from surveysim import SceneError, forecast_sweep, load_scene, run
from surveysim.output import writer as outputs
from surveysim.report.figures import style as drawing
from surveysim.report.figures import survey as figures
from surveysim.report.figures import sweep as sweep_figure
from surveysim.report.html.page import NoResultsError, write_report
from surveysim.runtime.engine import SERIAL
from surveysim.runtime.strict_json import strict_json
from surveysim.survey.checkpoint import NAME as CHECKPOINT
from tests.scenes import write_scene
from tests.unit.studies.test_sweep_run import WHITE


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return load_scene(write_scene(tmp_path_factory.mktemp("scene")))


@pytest.fixture(scope="module")
def result(scene):
    return run(scene, engine=SERIAL)


# ---------------------------------------------------------------- JSON


@pytest.mark.parametrize(
    "value, text",
    [
        (math.nan, "null"),
        (-math.inf, "null"),
        (np.float32(np.inf), "null"),
        (np.float32(0.5), "0.5"),
        (np.int64(3), "3"),
        (np.bool_(True), "true"),
        (np.array([1.0, np.nan]), "[1.0, null]"),
        (np.array(2), "2"),
        ({"a": (math.nan, [{"b": math.inf}]), "c": True}, '{"a": [null, [{"b": null}]], "c": true}'),
        ("NaN", '"NaN"'),
        (1.7976931348623157e308, "1.7976931348623157e+308"),
    ],
)
def test_strict_json(value, text):
    assert strict_json(value) == text
    json.loads(text, parse_constant=pytest.fail)


def test_what_is_no_json():
    with pytest.raises(TypeError):
        strict_json({"a": {1, 2}})


def test_unknown_numbers_of_a_summary_are_null_and_can_be_reported(result, tmp_path, monkeypatch):
    """In every place that holds a number with a fraction."""
    whole = outputs.summary(result)
    unknown = [(*keys, math.inf if len(keys) % 2 else math.nan) for keys in places(whole)]
    assert len(unknown) > 150
    for *keys, value in unknown:
        put(whole, keys, value)
    monkeypatch.setattr(outputs, "summary", lambda result: whole)
    outputs.write_outputs(tmp_path, result, False)
    text = (tmp_path / "summary.json").read_text()
    assert json.loads(text, parse_constant=pytest.fail)["estimate"]["sigma_ukcmb2"] is None
    assert "unknown" in (tmp_path / "report.html").read_text()


def places(content, keys=()):
    """Keys that lead to numbers, other than those of the computing itself, which are known."""
    if isinstance(content, float):
        yield keys
    elif isinstance(content, dict | list) and keys[:1] != ("run",):
        items = content.items() if isinstance(content, dict) else enumerate(content)
        for key, item in items:
            if key not in ("bin_correlation",):  # left out where it is not known
                yield from places(item, (*keys, key))


def put(content, keys, value):
    for key in keys[:-1]:
        content = content[key]
    content[keys[-1]] = value


# ---------------------------------------------------------------- names


@pytest.fixture
def changed(tmp_path):
    path = write_scene(tmp_path)
    return lambda overrides: load_scene(path, overrides)


def test_names_of_data_sets_are_checked_before_the_work(changed):
    for steps, words in (
        (["average"] * 20, r"compare: found 20 algorithms in order, whose names make 159 letters; 100 or fewer"),
        (["average", "planar"] * 8, r"compare: found 16 algorithms in order, whose names make 119 letters"),
    ):
        with pytest.raises(SceneError, match=words):
            changed({"cleaning.compare": [steps]})
    assert changed({"cleaning.compare": [["average"] * 12]}).cleaning.compare
    with pytest.raises(SceneError, match="noise_only_sets: found 'white' more than once"):
        changed({"score.noise_only_sets": ["white", "uncorrelated", "white"]})
    for name in ("../white", "con ", "wei\u00df", "white/../..", "a" * 300):
        with pytest.raises(SceneError, match="score.noise_only_sets"):
            changed({"score.noise_only_sets": [name]})
        with pytest.raises(SceneError, match="cleaning.compare"):
            changed({"cleaning.compare": [[name]]})


# ---------------------------------------------------------------- figures


def no_font(*arguments):
    raise ValueError("Failed to find font\nin many places\x1b[31m")


FAILURES = {
    "weather": no_font,
    "timestream_psd": lambda *arguments: 1 / 0,
    "map_psds": lambda *arguments: os.open("/nowhere/DejaVuSans.ttf", os.O_RDONLY),
    "transfer_functions": lambda *arguments: exec("raise RuntimeError"),
    "cumulative_sensitivity": lambda *arguments: "text".nothing,
    "bin_weights": lambda *arguments: np.zeros(3)[5],
}


def test_a_figure_that_fails_costs_a_line(result, tmp_path, monkeypatch, caplog):
    """Of any kind of error, beside others that fail or are drawn."""
    monkeypatch.setattr(figures, "save", lambda figure, path, full: path.write_bytes(b""))  # drawing takes time
    for name, fail in FAILURES.items():
        monkeypatch.setattr(figures, name, fail)
    for name in ("track_and_hits", "coadded_map"):
        monkeypatch.setattr(figures, name, lambda *arguments: drawing.new_figure(1, 1))
    (tmp_path / "figures").mkdir()
    monkeypatch.setattr("surveysim.report.html.survey.run_pictures", lambda *arguments: [])
    outputs.write_outputs(tmp_path, result, True)
    summary = json.loads((tmp_path / "summary.json").read_text())
    lines = [record.getMessage() for record in caplog.records]
    assert len({line.partition(" (")[0] for line in lines}) == len(lines) == len(FAILURES)
    assert "figure 'weather' can't be drawn (" in "".join(lines)
    assert all(line.startswith("figure '") and line.isprintable() and len(line) < 250 for line in lines)
    assert set(lines) <= set(summary["warnings"])
    assert "Warning: figure" in (tmp_path / "report.html").read_text()
    assert set(summary["files"]) == files(tmp_path) - {"summary.json"}
    assert "figures/weather.png" not in summary["files"] and "figures/map.png" in summary["files"]


def test_without_matplotlib(result, tmp_path, monkeypatch, caplog):
    def fail(*arguments):
        raise ImportError("no Agg")

    monkeypatch.setattr(figures, "drawings", fail)
    outputs.write_outputs(tmp_path, result, True)
    (line,) = (record.getMessage() for record in caplog.records)
    assert line == "figures can't be drawn (ImportError: no Agg); all else is written"
    assert set(json.loads((tmp_path / "summary.json").read_text())["files"]) == files(tmp_path) - {"summary.json"}


def test_results_are_there_before_figures(result, tmp_path, monkeypatch):
    """An interrupt, or a kill, while figures are drawn loses figures alone."""

    def stop(*arguments):
        seen.update(files(tmp_path))
        raise KeyboardInterrupt

    seen = set()
    monkeypatch.setattr(figures, "coadded_map", stop)
    with pytest.raises(KeyboardInterrupt):
        outputs.write_outputs(tmp_path, result, True)
    assert seen >= {"summary.json", "scene.json", "tables/scores.ecsv", "maps/actual.fits"}
    listed = set(json.loads((tmp_path / "summary.json").read_text())["files"])
    assert listed - {"report.html"} == files(tmp_path) - {"summary.json"}
    write_report(tmp_path)


def test_a_missing_figure_does_not_matter_to_the_report(result, tmp_path, monkeypatch):
    monkeypatch.setattr(outputs, "_of_run", lambda result: {"map": lambda path: path.write_bytes(b"")})
    (tmp_path / "figures").mkdir()
    monkeypatch.setattr("surveysim.report.html.survey.run_pictures", lambda *arguments: [])
    outputs.write_outputs(tmp_path, result, True)
    monkeypatch.undo()
    (tmp_path / "figures" / "map.png").unlink()
    assert write_report(tmp_path).is_file()


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    path = tmp_path_factory.mktemp("sweep") / "sweep.toml"
    axes = '"detector.psd" = ["2 mK2 / Hz", "3 mK2 / Hz"]\nmaps = {"score.jackknives" = [2, 3]}\n'
    path.write_text(f"{WHITE}\n[sweep]\n{axes}")
    return forecast_sweep(path)


@pytest.mark.parametrize("name", ["cost $x_{$", r"$\frac{1}{$ \alpha_^", "\u4f60\u597d", "x" * 500])
def test_texts_of_the_user_are_no_formulas(swept, tmp_path, name):
    """On an axis, at its ticks, in the legend and in the caption."""
    axes = tuple(replace(axis, name=name, values=((f"1 {name}",), (f"2 {name}",))) for axis in swept.sweep.axes)
    points = tuple(replace(point, label=name) for point in swept.sweep.points)
    result = replace(swept, sweep=replace(swept.sweep, axes=axes, points=points))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of letters that no font has
        assert drawn_whole(sweep_figure.draw_sweep(tmp_path / "sweep.png", result))


def drawn_whole(path):
    return path.read_bytes().endswith(b"IEND\xaeB`\x82")


# ---------------------------------------------------------------- whole files


def test_files_have_the_permissions_of_the_umask(result, tmp_path):
    old = os.umask(0o027)
    try:
        outputs.write_outputs(tmp_path, result, False)
    finally:
        os.umask(old)
    modes = {stat.S_IMODE((tmp_path / name).stat().st_mode) for name in files(tmp_path)}
    assert modes == {0o640}


def test_files_are_on_the_disk_before_they_have_their_name(tmp_path, monkeypatch):
    events = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: events.append(sorted(map(str, os.listdir(tmp_path)))))
    with atomic_write(tmp_path / "a.txt") as partial:
        partial.write_text("whole")
    assert events == [[f"a.txt.{os.getpid()}.part"]] and files(tmp_path) == {"a.txt"}


@pytest.fixture(scope="module")
def whole(scene, tmp_path_factory):
    """Contents of the files of a run."""
    out = tmp_path_factory.mktemp("whole")
    run(scene, out, engine=SERIAL, figures=False)
    return {name: (out / name).read_bytes() for name in files(out)}


@pytest.mark.parametrize("share", [0.001, 0.3, 0.6, 0.9])
def test_a_full_disk_leaves_no_half_written_file_and_the_checkpoint(scene, whole, tmp_path, monkeypatch, share):
    """No file may be larger than a share of the largest one: the run ends, and goes on once there is room."""
    monkeypatch.setattr("surveysim.survey.run.CHECKPOINT_SECONDS", 0.0)
    write, limits = outputs.write_outputs, resource.getrlimit(resource.RLIMIT_FSIZE)
    most = int(share * max(len(content) for name, content in whole.items() if name != CHECKPOINT))

    def with_full_disk(*arguments):
        resource.setrlimit(resource.RLIMIT_FSIZE, (most, limits[1]))
        try:
            write(*arguments)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)

    out = tmp_path / "out"
    with monkeypatch.context() as full:
        full.setattr("surveysim.api.surveys.write_outputs", with_full_disk)
        with pytest.raises(OSError) as caught:
            run(scene, out, engine=SERIAL, figures=False)
    assert caught.value.errno in (errno.EFBIG, errno.EIO) and caught.value.filename.startswith(str(out))
    there = files(out)
    assert CHECKPOINT in there and not [name for name in there if name.endswith(".part")]
    tables = [name for name in there if name in whole and name.startswith(("maps", "tables"))]
    assert all((out / name).read_bytes() == whole[name] for name in tables)
    run(scene, out, engine=SERIAL, figures=False, resume=True)
    assert files(out) == set(whole)
    assert all((out / name).read_bytes() == whole[name] for name in whole if name.startswith(("maps", "tables")))


def files(directory):
    return {path.relative_to(directory).as_posix() for path in directory.rglob("*") if path.is_file()}


def test_a_summary_without_its_lists_is_refused_in_a_line(result, tmp_path):
    outputs.write_outputs(tmp_path, result, False)
    content = json.loads((tmp_path / "summary.json").read_text())
    for key in ("scores", "discarded", "run", "stopped"):
        (tmp_path / "summary.json").write_text(json.dumps(content | {key: []}))
        with pytest.raises(NoResultsError, match="results that can't be read") as caught:
            write_report(tmp_path)
        assert str(caught.value).isprintable()
