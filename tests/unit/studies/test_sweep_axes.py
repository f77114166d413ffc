"""Sweeps as they are read: axes, points, numbers of quantities, and every error of the table [sweep]."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from surveysim import SceneError, load_scene, load_sweep
from surveysim.scene.kinds import is_sweep
from surveysim.scene.scene import scene_hash
from surveysim.studies.sweep.axes import Axis, numbers_of, value_text
from tests.scenes import SMALL_SCENE, without_sections

SPEEDS = '"scan.speed" = ["3 arcmin / s", "4 arcmin / s", "0.1 deg / s"]\n'
PITCH = '[sweep.pitch]\n"instrument.layout.pitch_f_lambda" = [0.7, 1.0]\n"instrument.layout.dead" = [[], [3, 5]]\n'


@pytest.fixture
def write(tmp_path):
    def write(table, scene=SMALL_SCENE):
        path = tmp_path / "small.toml"
        path.write_text(f"{scene}\n[sweep]\n{table}")
        return path

    return write


@pytest.fixture
def refused(write):
    """The error of a table, less the file that it begins with."""

    def refused(table, overrides=None, scene=SMALL_SCENE):
        path = write(table, scene)
        with pytest.raises(SceneError) as caught:
            load_sweep(path, overrides)
        lines = str(caught.value).splitlines()
        assert all(line.startswith(f"{path}: ") for line in lines)
        return [line.removeprefix(f"{path}: ") for line in lines]

    return refused


def test_every_combination_is_a_point(write):
    sweep = load_sweep(write(SPEEDS + PITCH))
    assert [axis.name for axis in sweep.axes] == ["scan.speed", "pitch"] and sweep.name == "small"
    assert [axis.labels for axis in sweep.axes][1] == ["0.7", "1.0"]
    assert [point.number for point in sweep.points] == list(range(6))
    assert [point.place for point in sweep.points] == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)]
    speeds = [point.scene.scan.speed_rad_s for point in sweep.points]
    np.testing.assert_allclose(speeds, np.radians(np.repeat([3, 4, 6], 2) / 60))
    assert [point.scene.instrument.layout.dead for point in sweep.points] == [(), (3, 5)] * 3
    assert [point.n_det for point in sweep.points] == [19, 17] * 3
    assert sweep.points[1].detector_samples == 17 * 4 * 60 * 4  # detectors, scans, samples, observations
    assert {point.scene.seed for point in sweep.points} == {11}
    assert sweep.points[1].label == "scan.speed = 3 arcmin / s, pitch = 1.0"
    assert list(sweep.points[1].settings.values()) == ["3 arcmin / s", 1.0, [3, 5]]


def test_points_are_the_scenes_with_those_keys(write):
    """The same scene as one without a sweep and with the keys set, by the hash of all that results depend on."""
    path = write(
        SPEEDS + '"cleaning.algorithm" = [["average"], ["planar", "local"]]\n"cleaning.neighbour_radius" = [2.0]\n'
    )
    sweep = load_sweep(path, {"observations": 6})
    settings = {
        "scan.speed": "4 arcmin / s",
        "cleaning.algorithm": ["planar", "local"],
        "cleaning.neighbour_radius": 2.0,
    }
    assert scene_hash(sweep.points[3].scene) == scene_hash(load_scene(path, {"observations": 6} | settings))
    assert sweep.points[3].scene.cleaning.algorithm == ("planar", "local")
    assert "cleaning.algorithm = planar+local" in sweep.points[3].label


def test_a_scene_sets_its_sweep_aside(write, tmp_path):
    path, plain = write(SPEEDS), tmp_path / "plain.toml"
    plain.write_text(SMALL_SCENE)
    assert is_sweep(path) and not is_sweep(plain)
    assert scene_hash(load_scene(path, {"name": "one"})) == scene_hash(load_scene(plain, {"name": "one"}))
    with pytest.raises(SceneError, match=r"sweep: missing; a table of keys with lists of values is expected"):
        load_sweep(plain)


def test_comments_of_the_table_assume_nothing(write):
    path = write("observations = [2, 4]  # assumed: a few\n" + '"scan.scans" = [4]  # assumed\n')
    assert load_scene(path).assumed == () == load_sweep(path).points[0].scene.assumed


def test_values_replace_what_is_assumed(write):
    scene = SMALL_SCENE.replace('speed = "4 arcmin / s"', 'speed = "4 arcmin / s"  # assumed: a guess')
    path = write(SPEEDS, scene)
    assert len(load_scene(path).assumed) == 1 and load_sweep(path).points[0].scene.assumed == ()


def test_the_base_need_not_have_the_key(write):
    """A key that only points have: the base alone is no scene."""
    scene = SMALL_SCENE.replace("pitch_f_lambda = 0.7\n", "")
    path = write('"instrument.layout.pitch_f_lambda" = [0.7, 0.8]\n', scene)
    assert len(load_sweep(path).points) == 2
    with pytest.raises(SceneError, match="pitch_f_lambda: missing"):
        load_scene(path)


@pytest.mark.parametrize(
    "table, words",
    [
        ("", "sweep: found {}; a table of keys with lists of values is expected"),
        ('"scan.speed" = []\n', "sweep.scan.speed: found []; a list of one or more values is expected"),
        ('"scan.speed" = "4 arcmin / s"\n', "sweep.scan.speed: found '4 arcmin / s'; a list of values, or a table"),
        ("[sweep.a]\n", "sweep.a: found {}; a list of values, or a table"),
        ('[sweep.a]\n"scan.speed" = 3\n', "sweep.a.scan.speed: found 3; a list of one or more values"),
        (
            '[sweep.a]\n"scan.scans" = [4, 5]\nobservations = [1, 2, 3]\n',
            "sweep.a: found lists of 2 and 3 values; one length is expected",
        ),
        ('"scan.sped" = [1]\n', "sweep.scan.sped: unknown key; did you mean scan.speed?"),
        ("scans = [1]\n", "sweep.scans: unknown key; did you mean scan?"),
        ("horn_f_lambda = [1]\n", "sweep.horn_f_lambda: unknown key; did you mean instrument.horn_f_lambda?"),
        ("quux = [1]\n", "sweep.quux: unknown key; allowed are atmosphere, cleaning"),
        ('"scan.quux" = [1]\n', "sweep.scan.quux: unknown key; allowed are acceleration, amplitude_x"),
        ('"title.x" = [1]\n', "sweep.title.x: unknown key of a scene"),
        ("scan.scans = [4, 5]\n", 'sweep.scan.scans: unknown key; a key with dots goes in quotes: "scan.scans"'),
        ("seed = [1, 2]\n", "sweep.seed: found 'seed', which all points have in common; another key is expected"),
        ('name = ["a", "b"]\n', "sweep.name: found 'name'"),
        ('title = ["a", "b"]\n', "sweep.title: found 'title'"),
        ("assumed = [[]]\n", "sweep.assumed: unknown key"),
        ('"sweep.x" = [1]\n', "sweep.sweep.x: found 'sweep.x'"),
        ('[sweep.a]\nseed = [1]\n"scan.scans" = [4]\n', "sweep.a.seed: found 'seed'"),
        (
            '"scan.scans" = [4]\n[sweep.a]\n"scan.scans" = [5]\n',
            "sweep: found 'scan.scans' and 'scan.scans'; every key on one axis is expected",
        ),
        ('"scan.scans" = [4]\nscan = [{}]\n', "sweep: found 'scan' and 'scan.scans'"),
        (
            f'"scan.scans" = {list(range(1, 41))}\nobservations = {list(range(2, 28))}\n',
            "sweep: found 1040 points; 1000 or less are expected",
        ),
    ],
)
def test_wrong_tables(refused, table, words):
    (line,) = refused(table)
    assert line.startswith(words), line


@pytest.mark.parametrize("name", ["", r"a\u001b[31m", r"two\nlines", "x" * 301])
def test_names_of_axes_that_are_no_line(refused, name):
    (text,) = refused(f'[sweep."{name}"]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]\n')
    assert "found the axis" in text and text.isprintable()


def test_every_wrong_axis_has_its_line(refused):
    assert len(refused("seed = [1]\ntitle = [2]\n")) == 2


def test_not_a_table(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text("sweep = 3\n" + SMALL_SCENE)
    with pytest.raises(SceneError, match="sweep: found 3; a table"):
        load_sweep(path)


def test_keys_that_are_set_and_swept(refused):
    """An override that the sweep would replace is refused, and so is one of the table itself."""
    words = "scan: set, and on an axis of the sweep; a key that it leaves alone is expected"
    assert refused(SPEEDS, {"scan": {}}) == [words]
    assert refused(SPEEDS, {"scan.speed": "4 arcmin / s"}) == [f"scan.speed{words.removeprefix('scan')}"]
    (line,) = refused(SPEEDS, {"sweep.observations": [2, 4]})
    assert line.startswith("sweep: unknown key; ")


def test_errors_name_their_points(refused):
    """A value that one point has, that several have, and an error that all have."""
    (line,) = refused('"scan.speed" = ["4 arcmin / s", "4 arcmin"]\nobservations = [2]\n')
    assert line.startswith("point (scan.speed = 4 arcmin, observations = 2): scan.speed: found '4 arcmin'; a quantity")
    (line,) = refused('"scan.speed" = ["4 arcmin / s", "4 arcmin"]\nobservations = [2, 3, 4]\n')
    assert line.startswith("point (scan.speed = 4 arcmin, observations = 2) and 2 more: scan.speed: found")
    (line,) = refused(SPEEDS, {"scan.typo": 1})
    assert line.startswith("scan.typo: unknown key")


def test_errors_of_a_relative_path_name_the_file_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("relative.toml").write_text("[sweep]\nobservations = [2, 3]\n")
    with pytest.raises(SceneError) as caught:
        load_sweep("relative.toml")
    assert all(line.count("relative.toml: ") == 1 for line in str(caught.value).splitlines())
    assert all(line.startswith("relative.toml: ") for line in str(caught.value).splitlines())


def test_errors_of_the_camera_and_the_map_name_their_points(refused):
    """These errors show only in a prepared scene."""
    (line,) = refused('"score.ell_max" = [12000, 30000]\n')
    assert line.startswith("point (score.ell_max = 30000): score.ell_max: found 30000; the map pixel's")


def test_a_sweep_needs_a_score(refused):
    (line,) = refused(SPEEDS, scene=without_sections(SMALL_SCENE, "score"))
    assert line == "score: missing; scenes are compared by their scores"


def test_a_list_of_positions_is_beside_the_scene(write, tmp_path):
    for name in ("one", "two"):
        (tmp_path / f"{name}.ecsv").write_text(
            "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: x, unit: arcsec, datatype: float64}\n"
            "# - {name: y, unit: arcsec, datatype: float64}\nx y\n0 0\n40 0\n0 40\n80 80\n"
        )
    start, end = SMALL_SCENE.index("[instrument.layout]"), SMALL_SCENE.index("[scan]")
    scene = (SMALL_SCENE[:start] + SMALL_SCENE[end:]).replace("mask_separation_f_lambda = 1.3\n", "")
    sweep = load_sweep(write('"instrument.positions" = ["one.ecsv", "two.ecsv"]\n', scene))
    assert [point.scene.instrument.positions for point in sweep.points] == [
        tmp_path / "one.ecsv",
        tmp_path / "two.ecsv",
    ]


@pytest.mark.parametrize(
    "values, numbers, unit",
    [
        ([0.5, 1], [0.5, 1.0], ""),
        (["2 arcmin / s", "0.1 deg / s"], [2.0, 6.0], "arcmin / s"),
        (["11/3", "3"], [11 / 3, 3.0], ""),
        (["1 m", "1 s"], None, ""),
        (["average", "planar"], None, ""),
        (["field", 1], None, ""),
        (["08h49m12s", "1 deg"], None, ""),
        (["[1, 2] mK2"], None, ""),
        ([[1], [2]], None, ""),
        ([math.inf, 1.0], None, ""),
    ],
)
def test_numbers_of_values(values, numbers, unit):
    found = numbers_of(values)
    if numbers is None:
        assert found is None
    else:
        np.testing.assert_allclose(found[0], numbers)
        assert found[1] == unit


def test_values_as_text():
    assert value_text("4 arcmin / s") == "4 arcmin / s" and value_text(0.5) == "0.5"
    assert value_text(["planar", "local"]) == "planar+local" and value_text([]) == "[]"
    assert value_text([1, 2]) == "[1, 2]"
    axis = Axis("dead", ("instrument.layout.dead",), ((list(range(100)),), ([],)))
    assert axis.at(0) == "dead = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11..." and axis.labels[1] == "[]"


# ---------------------------------------------------------------- labels


def camera_axis(*values):
    return Axis("camera", ("instrument.layout.extent", "instrument.layout.pitch_f_lambda", "scan.scans"), values)


def test_the_first_key_names_steps_that_it_tells_apart():
    axis = camera_axis(("12 arcmin", 0.8, 4), ("8 arcmin", 1.2, 4))
    assert axis.labels == ["12 arcmin", "8 arcmin"] and axis.at(1) == "camera = 8 arcmin"


def test_all_keys_that_differ_name_steps_that_the_first_does_not_tell_apart():
    """Three points, of which the first and the third have the same first key; the key that all share is left out."""
    axis = camera_axis(("12 arcmin", 0.8, 4), ("8 arcmin", 0.8, 4), ("12 arcmin", 1.2, 4))
    assert axis.labels == [
        "extent = 12 arcmin, pitch_f_lambda = 0.8",
        "extent = 8 arcmin, pitch_f_lambda = 0.8",
        "extent = 12 arcmin, pitch_f_lambda = 1.2",
    ]
    assert axis.at(2) == "camera (extent = 12 arcmin, pitch_f_lambda = 1.2)"
    axis = camera_axis(("12 arcmin", 0.8, 4), ("12 arcmin", 1.2, 4))
    assert axis.labels == ["pitch_f_lambda = 0.8", "pitch_f_lambda = 1.2"]


def test_keys_whose_last_parts_are_alike_are_whole():
    axis = Axis("noise", ("photon.psd", "detector.psd"), ((1, 2), (1, 3), (2, 2)))
    assert axis.labels[0] == "photon.psd = 1, detector.psd = 2"


def test_steps_that_look_alike_have_their_number():
    axis = Axis("scans", ("scan.scans",), ((4,), (5,), (4,)))
    assert axis.labels == ["4 #0", "5", "4 #2"]
    dead = Axis("dead", ("instrument.layout.dead",), ((list(range(30)),), (list(range(31)),)))
    assert [label.rpartition(" ")[2] for label in dead.labels] == ["#0", "#1"]


def test_labels_of_points_are_unique(write):
    table = '[sweep.a]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s", "3 arcmin / s"]\n"scan.scans" = [4, 4, 5]\n'
    labels = [point.label for point in load_sweep(write("observations = [2, 3]\n" + table)).points]
    assert len(set(labels)) == 6
    assert labels[2] == "observations = 2, a (speed = 3 arcmin / s, scans = 5)"


# ---------------------------------------------------------------- the reference point


@pytest.mark.parametrize(
    "given, expected",
    [
        (None, 0),
        (4, 4),
        ("scan.speed = 4 arcmin / s, pitch = 1.0", 3),
        ("pitch=1.0 ,scan.speed=4 arcmin / s", 3),
        ('scan.speed = 0.1 deg / s, "" ', None),
        ("scan.speed = 4 arcmin / s, instrument.layout.dead = [3, 5]", 3),
        ("scan.speed = 0.1 deg / s", None),
        ("speed = 4 arcmin / s", None),
        ("scan.speed = 4 arcmin / s, pitch = 1", None),
        ("", None),
        (6, None),
        (-1, None),
        (True, None),
    ],
)
def test_reference_points(write, given, expected):
    """By number or by values that one point alone has; in the file or, before it, in the call."""
    path = write(SPEEDS + PITCH)
    values = {None: "", True: "reference = true\n"}
    in_file = write(values.get(given, f"reference = {json.dumps(given)}\n") + SPEEDS + PITCH)
    if expected is not None:
        assert load_sweep(in_file).reference == expected
        write(SPEEDS + PITCH)
        assert load_sweep(path, reference=given).reference == expected
        return
    with pytest.raises(SceneError, match=r"small.toml: sweep.reference: found .* expected$"):
        load_sweep(in_file)
    write("reference = 2\n" + SPEEDS + PITCH)
    with pytest.raises(SceneError, match=r"small.toml: --reference: found .* expected$"):
        load_sweep(path, reference=given)


def test_an_axis_may_be_called_reference(write):
    sweep = load_sweep(write('[sweep.reference]\n"scan.scans" = [4, 5]\n'))
    assert sweep.reference == 0 and sweep.points[1].label == "reference = 5"


def test_a_reference_alone_is_no_sweep(refused):
    assert refused("reference = 1\n") == ["sweep: found 'reference' alone; a key with a list of values is expected"]


def test_a_reference_leaves_the_scenes_alone(write):
    one = load_sweep(write(SPEEDS))
    other = load_sweep(write("reference = 2\n" + SPEEDS))
    assert [scene_hash(point.scene) for point in one.points] == [scene_hash(point.scene) for point in other.points]
