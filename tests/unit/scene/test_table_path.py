"""Paths of tables, which know the state of their file."""

import os
import pickle
from pathlib import Path

from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.scene.table_path import TablePath
from tests.scenes import SMALL_SCENE, with_scan

SCAN = 'pattern = "track"\ntrack_table = "track.csv"\nchunk = "8 s"\ndither = "0 arcmin"\nsample_rate = "10 Hz"\n'


def test_a_changed_file_has_another_path(tmp_path):
    file = tmp_path / "table"
    missing = TablePath(file)
    file.write_text("1")
    before, again = TablePath(file), TablePath(file)
    os.utime(file, ns=(0, 0))
    after = TablePath(file)
    assert before == again and before != after and missing != before and hash(before) == hash(after)
    assert before == file and file == after and isinstance(before, Path) and str(before) == str(file)
    assert pickle.loads(pickle.dumps(before)) == before != after


def test_a_scene_that_is_loaded_again_has_the_table_of_now(tmp_path):
    """The same path and length, and twice the speed."""
    scene, table, speeds = tmp_path / "scene.toml", tmp_path / "track.csv", []
    scene.write_text(with_scan(SMALL_SCENE, SCAN))
    for step in (0.001, 0.002):
        rows = [f"{second},{132.2 + step * second:.3f},44.84" for second in range(40)]
        table.write_text("\n".join(["time [s],ra [deg],dec [deg]", *rows]) + "\n")
        speeds.append(prepare(load_scene(scene)).observing.scans.speed_rad_s)
    assert speeds[1] / speeds[0] > 1.9
