"""Names of files that commands write: all are among those that may be removed."""

import json

import pytest

from surveysim import load_scene, load_sweep, run
from surveysim.output.expected_files import of_forecast, of_run
from surveysim.output.expected_study_files import EXTREMES, accuracy_settings, of_accuracy, of_paper, of_sweep
from surveysim.output.file_names import WRITTEN
from surveysim.output.record import RECORD
from surveysim.paper.scenes import FIGURES, SCENES, TABLES
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL
from tests.scenes import SMALL_SCENE, write_scene

SWEEP = '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]\n'
RICH = {
    "cleaning.compare": [["planar"], ["average", "local"]],
    "cleaning.neighbour_radius": 1.2,
    "map.healpix_nside": 1024,
}


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def test_every_name_may_be_removed(path):
    scene = load_scene(path, RICH)
    found = [of_run(prepare(scene), True, True), of_forecast(scene), of_accuracy(scene, {}, True), EXTREMES]
    items = [f"table {n}" for n in TABLES] + [f"figure {n}" for n in FIGURES] + [f"{band} GHz" for band in SCENES]
    found.append(of_paper(items))
    path.write_text(SMALL_SCENE + SWEEP)
    sweep = load_sweep(path)
    found += [of_sweep(sweep, "run", True), of_sweep(sweep, "forecast", True)]
    names = [name for results in found for name in results.all_names]
    assert len(names) > 100 and not [name for name in names if not WRITTEN.fullmatch(name)]


def test_a_run_writes_no_other_file(path, tmp_path):
    """Whatever it writes is recorded, and hence replaced by the next one."""
    out = tmp_path / "out"
    for _ in range(2):
        run(load_scene(path, {"observations": 2}), out, engine=SERIAL, figures=False, save_timestreams=True)
    there = {item.relative_to(out).as_posix() for item in out.rglob("*") if item.is_file()}
    assert json.loads((out / RECORD).read_text())["files"].keys() == there - {RECORD}
    assert {"maps/actual.fits", "timestreams/0001.h5", "scene.toml"} <= there


def test_settings_of_accuracy():
    """Those that are so by default are left out; others make other results."""
    assert accuracy_settings(0.01, 8, 60) == {}
    assert accuracy_settings(0.02, 8, 30) == {"accuracy.reference_error": 0.02, "accuracy.observations": 30}


@pytest.mark.parametrize(
    "change", [{"seed": 12}, {"observations": 3}, {"name": "other"}, {"numerics.max_block_memory": "1 GB"}]
)
def test_results_of_other_scenes_differ(path, change):
    one, other = (of_run(prepare(load_scene(path, given)), True, False) for given in ({}, change))
    assert one.sha256 != other.sha256
    same = of_run(prepare(load_scene(path, {"title": "another"})), False, True)
    assert one.sha256 == same.sha256
