"""The scene file in an output directory: run again, it gives the same results."""

import tomllib

import pytest

from surveysim import load_scene, load_sweep
from surveysim.cli.options import setting
from surveysim.output.file_names import INPUT, WRITTEN
from surveysim.output.scene_copy import SCENE_FILE, scene_files, sweep_files
from surveysim.scene.fields import FILE
from surveysim.scene.file_keys import file_keys
from surveysim.scene.keys import all_keys
from surveysim.scene.scene import scene_hash
from surveysim.studies.sweep.axes import sweep_hash
from tests.scenes import SMALL_SCENE, write_scene

LAYOUT = "[instrument.layout]\nrings = 2\npitch_f_lambda = 0.7\ndead = [5]\n"
TABLE = (
    "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: x, unit: arcsec, datatype: float64}\n"
    "# - {name: y, unit: arcsec, datatype: float64}\nx y\n0 0\n40 0\n80 0\n"
)
WITH_TABLE = SMALL_SCENE.replace(LAYOUT, "").replace("[instrument]\n", '[instrument]\npositions = "camera.ecsv"\n')
WITH_TABLE = WITH_TABLE.replace('coherence = "field"', 'coherence = "none"')


def again(files, folder):
    """Put the files elsewhere and load the scene there."""
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder / SCENE_FILE


@pytest.mark.parametrize(
    "settings",
    [
        (),
        ("seed=3",),
        ("scan.speed=8 arcmin / s", "observations=2"),
        ("name=other", "title=a # b \\ c"),
        ("cleaning.compare=[['planar'], ['average', 'local']]", "cleaning.neighbour_radius=1.2"),
        ("numerics.max_block_memory=1 GB",),
        ("sky={cmb_band_power = '10 uK2'}",),
        ("instrument.layout={rings = 3, pitch_f_lambda = 0.8}",),
        ("score.reference={source = 'a', values = {actual = '2 uK2'}}",),
    ],
)
@pytest.mark.parametrize("name", ["small", "scene", "first.light-2"])
def test_the_same_scene(tmp_path, settings, name):
    """Whatever its file and the folder are called."""
    path = tmp_path / f"{name}.toml"
    path.write_text(SMALL_SCENE)
    scene = load_scene(path, dict(map(setting, settings)))
    files = scene_files(scene)
    found = load_scene(again(files, tmp_path / "elsewhere"))
    assert (found.name, found.title) == (scene.name, scene.title) and scene_hash(found) == scene_hash(scene)
    assert scene_files(found) == files


@pytest.mark.parametrize("settings", [{"score": None}, {"sky": None, "seed": 5}, {"atmosphere.outer_scale": None}])
def test_the_same_scene_without_a_part(tmp_path, settings):
    """Left out in Python, by None."""
    path = write_scene(tmp_path)
    scene = load_scene(path, settings)
    assert scene_hash(load_scene(again(scene_files(scene), tmp_path / "elsewhere"))) == scene_hash(scene)


def test_comments_stay_but_those_of_other_values(tmp_path):
    path = tmp_path / "small.toml"
    text = SMALL_SCENE.replace("seed = 11", "seed = 11  # assumed: any").replace("scans = 4", "scans = 4  # assumed")
    path.write_text(text)
    scene = load_scene(path, {"seed": 12})
    found = scene_files(scene)[SCENE_FILE].decode()
    assert "seed = 12 # set for this run\n" in found and "scans = 4  # assumed\n" in found
    assert load_scene(again(scene_files(scene), tmp_path / "there")).assumed == scene.assumed
    assert scene_files(load_scene(path))[SCENE_FILE].decode() == f'name = "small"\n{text}'
    path.write_text(f'name = "mine"\n{text}')
    assert scene_files(load_scene(path))[SCENE_FILE].decode() == path.read_text()


def test_a_table_comes_along(tmp_path):
    """The file may be changed or go: results are of what it was."""
    (tmp_path / "camera.ecsv").write_text(TABLE)
    path = tmp_path / "small.toml"
    path.write_text(WITH_TABLE)
    scene = load_scene(path)
    digest, files = scene_hash(scene), scene_files(scene)
    assert files["positions.ecsv"] == TABLE.encode()
    (tmp_path / "camera.ecsv").unlink()
    assert scene_hash(load_scene(again(files, tmp_path / "elsewhere"))) == digest
    (tmp_path / "elsewhere").rename(tmp_path / "moved")
    assert scene_hash(load_scene(tmp_path / "moved" / SCENE_FILE)) == digest


def test_keys_of_files_are_those_of_the_schema():
    assert set(file_keys()) == {key for key, item in all_keys().items() if item.get("format") == FILE}


@pytest.mark.parametrize("key", file_keys())
@pytest.mark.parametrize("suffix", ["", ".ecsv", ".fits", ".dat-2"])
def test_a_directory_knows_the_copies_of_all_tables(key, suffix):
    """A new run replaces them, as it does all that this program writes."""
    for name in (key.rpartition(".")[2], f"{key.rpartition('.')[2]}_12"):
        assert WRITTEN.fullmatch(name + suffix) and INPUT.fullmatch(name + suffix)
        assert not WRITTEN.fullmatch(f"{name}s{suffix}")


def test_a_scene_that_was_changed_in_python_has_no_file(tmp_path):
    path = write_scene(tmp_path)
    scene = load_scene(path)
    assert scene_files(scene.model_copy(update={"seed": 99})) == {}
    assert scene_files(scene.model_copy()).keys() == {SCENE_FILE}


@pytest.mark.parametrize(
    "sweep, settings, reference",
    [
        ('"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]', {}, None),
        ('"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]', {"observations": 3}, 1),
        ('reference = 1\nseeds = { "scan.scans" = [4, 5], "map.pixel" = ["30 arcsec", "20 arcsec"] }', {}, 0),
    ],
)
def test_the_same_sweep(tmp_path, sweep, settings, reference):
    path = tmp_path / "speeds.toml"
    path.write_text(f"{SMALL_SCENE}\n[sweep]\n{sweep}\n")
    made = load_sweep(path, settings, reference)
    files = sweep_files(made)
    found = load_sweep(again(files, tmp_path / "elsewhere"))
    assert (found.name, found.reference) == (made.name, made.reference) and sweep_hash(found) == sweep_hash(made)
    assert sweep_files(found) == files


def test_a_sweep_of_tables(tmp_path):
    """Tables of the points, equal ones once."""
    (tmp_path / "camera.ecsv").write_text(TABLE)
    (tmp_path / "other.ecsv").write_text(TABLE.replace("40 0", "20 0"))
    path = tmp_path / "cameras.toml"
    sweep = '[sweep]\n"instrument.positions" = ["camera.ecsv", "other.ecsv"]\n'
    path.write_text(f"{WITH_TABLE}\n{sweep}")
    made = load_sweep(path)
    files = sweep_files(made)
    assert files.keys() == {SCENE_FILE, "positions.ecsv", "positions_1.ecsv"}
    content = tomllib.loads(files[SCENE_FILE].decode())
    assert content["sweep"]["instrument.positions"] == ["positions.ecsv", "positions_1.ecsv"]
    assert sweep_hash(load_sweep(again(files, tmp_path / "elsewhere"))) == sweep_hash(made)
