"""The section [scan] as a union by its pattern: defaults, errors, hashes and words."""

import json

import pytest

from surveysim.report.html.scan_words import _WORDS, scan_words
from surveysim.runtime.errors import SceneError
from surveysim.scene.keys import scene_sections
from surveysim.scene.scan_patterns import SCAN_SECTIONS, RasterScan
from surveysim.scene.scene import load_scene, resolved, scene_hash
from surveysim.scene.single_values import wrong_value
from surveysim.scene.unions import choice
from tests.scenes import SMALL_SCENE, with_scan, write_scene

COMMON = 'duration = "1 min"\nchunk = "15 s"\ndither = "0 arcmin"\nsample_rate = "10 Hz"\n'
DAISY = f'pattern = "daisy"\nradius = "4 arcmin"\nradial_period = "7 s"\n{COMMON}'
LISSAJOUS = f"""pattern = "lissajous"
amplitude_x = "4 arcmin"
amplitude_y = "3 arcmin"
period_x = "7 s"
period_y = "5.1 s"
angle = "30 deg"
angle_step = "5 deg"
{COMMON}"""
PONG = f"""pattern = "pong"
width = "18 arcmin"
height = "14 arcmin"
spacing = "1 arcmin"
velocity = "2 arcmin / s"
terms = 5
{COMMON}"""

RASTER = """speed = "4 arcmin / s"
scans = 4
duration = "6 s"
turnaround = "2 s"
step = "3 arcmin"
dither = "0 arcmin"
sample_rate = "10 Hz"
"""
ADDED = """
[scan.lissajous]
amplitude_x = "1 arcmin"
amplitude_y = "2 arcmin"
period_x = "30 s"
period_y = "41 s"
"""


def errors(folder, keys):
    with pytest.raises(SceneError) as raised:
        load_scene(write_scene(folder, with_scan(SMALL_SCENE, keys)))
    return [line.partition(".toml: ")[2] for line in str(raised.value).splitlines()]


def test_a_scan_without_a_pattern_is_a_raster(tmp_path):
    scene = load_scene(write_scene(tmp_path))
    named = load_scene(write_scene(tmp_path), {"scan.pattern": "raster"})
    assert isinstance(scene.scan, RasterScan) and scene.scan.pattern == "raster"
    assert scene_hash(named) == scene_hash(scene)
    assert json.loads(resolved(scene))["scan"]["pattern"] == "raster"


def test_patterns_of_equal_keys_have_hashes_of_their_own(tmp_path):
    daisy = load_scene(write_scene(tmp_path, with_scan(SMALL_SCENE, DAISY)))
    assert scene_hash(daisy) != scene_hash(load_scene(tmp_path / "small.toml", {"scan.radius": "5 arcmin"}))


def test_errors_name_the_keys_of_the_pattern(tmp_path):
    known = ", ".join(repr(choice(item, "pattern")) for item in SCAN_SECTIONS)
    assert errors(tmp_path, 'pattern = "dasy"\n') == [f"scan.pattern: found 'dasy'; one of {known} is expected"]
    assert errors(tmp_path, "pattern = 3\n") == [f"scan.pattern: found 3; one of {known} is expected"]
    assert errors(tmp_path, DAISY.replace("radius", "radios")) == [
        "scan.radios: unknown key; did you mean scan.radius?"
    ]
    (line,) = errors(tmp_path, f'{DAISY}step = "1 arcmin"\n')
    assert line.startswith("scan.step: unknown key; allowed are angle, angle_step, chunk, dither, duration, frame, ")
    assert errors(tmp_path, DAISY.replace('radial_period = "7 s"\n', "")) == [
        "scan.radial_period: missing; this key is expected"
    ]
    assert errors(tmp_path, DAISY.replace("15 s", "2 min")) == [
        "scan.chunk: found 120 s in a duration of 60 s; a chunk that fits 1 to 100000 times is expected"
    ]
    assert errors(tmp_path, DAISY.replace("15 s", "0.7 s")) == [
        "scan.chunk: found 7 samples a scan; 8 or more are expected"
    ]


def test_values_of_a_key_are_judged_by_all_patterns_that_have_it():
    assert wrong_value("scan.pattern", "pong") == wrong_value("scan.duration", "3 min") == ""
    assert wrong_value("scan.radius", "3 s").startswith("scan.radius: found '3 s'")
    names = "'raster', 'azimuth', 'daisy', 'lissajous', 'pong' or 'track' is expected"
    assert wrong_value("scan.pattern", "dasy") == f"scan.pattern: found 'dasy'; {names}"


def test_every_pattern_has_its_list_of_keys():
    headings = [section.heading for section in scene_sections() if section.name == "scan"]
    assert headings == [f'`[scan]` `pattern = "{choice(item, "pattern")}"`' for item in SCAN_SECTIONS]


def test_report_has_words_for_every_pattern():
    assert list(_WORDS) == [choice(item, "pattern") for item in SCAN_SECTIONS]


@pytest.mark.parametrize(
    "keys, words",
    [
        (
            RASTER + ADDED,
            "4 scans of 6 s at 4 arcmin/s, with a Lissajous figure of amplitudes 1 arcmin and 2 arcmin, with periods of"
            " 30 s and 41 s added, turnarounds of 2 s. Scans are 3 arcmin apart.",
        ),
        (
            DAISY,
            "a daisy of radius 4 arcmin, with a period of 7 s along a diameter, for 60 s in chunks of 15 s. Its axes"
            " are along right ascension and declination.",
        ),
        (
            LISSAJOUS,
            "a Lissajous figure of amplitudes 4 arcmin and 3 arcmin, with periods of 7 s and 5.1 s, for 60 s in chunks"
            " of 15 s. Its axes are along right ascension and declination, turned by 30 deg, 5 deg more in each"
            " observation.",
        ),
        (
            f"{DAISY}{ADDED}",
            "a daisy of radius 4 arcmin, with a period of 7 s along a diameter, with a Lissajous figure of amplitudes 1"
            " arcmin and 2 arcmin, with periods of 30 s and 41 s added, for 60 s in chunks of 15 s. Its axes are along"
            " right ascension and declination.",
        ),
        (
            PONG,
            "a pong of 18 arcmin by 14 arcmin, with lines 1 arcmin apart at 2 arcmin/s, for 60 s in chunks of 15 s. Its"
            " axes are along right ascension and declination.",
        ),
    ],
    ids=["raster", "daisy", "lissajous", "added", "pong"],
)
def test_report_says_what_the_telescope_does(tmp_path, keys, words):
    scene = load_scene(write_scene(tmp_path, with_scan(SMALL_SCENE, keys)))
    assert scan_words(json.loads(resolved(scene))["scan"]) == words
