"""The cameras that ship beside published numbers, and each number with a source."""

import re
import tomllib

import pytest

from docs.cameras import KINDS, PAGE, numbers, ours, with_table
from surveysim import run
from surveysim.runtime.engine import SERIAL
from surveysim.scene.bands import load_bands
from surveysim.scene.keys import scene_keys
from surveysim.scene.kinds import has_bands
from surveysim.scene.scene import load_scene
from surveysim.scene.shipped import camera_folder, camera_titles

NUMBERS = numbers()
CAMERAS = list(camera_titles())


@pytest.mark.parametrize("number", NUMBERS, ids=lambda number: f"{number['camera']}-{number['kind']}-{number['value']}")
def test_published_numbers(number):
    """Within the tolerance that `cameras.toml` states with its reason."""
    assert abs(ours(number) / number["value"] - 1) < number["tolerance"]
    assert number["because"] and number["source"] and number["kind"] in KINDS


def test_calibrated_numbers_agree_closely():
    """What is calibrated says so in its reason and in the scene, and reaches its value."""
    calibrated = [number for number in NUMBERS if number.get("calibrated")]
    assert {number["tolerance"] for number in calibrated} <= {0.02, 0.1}
    for number in calibrated:
        assert number["because"].startswith("calibrated: ")
        assert "calibrated (against" in (camera_folder() / f"{number['camera']}.toml").read_text(encoding="utf-8")


def test_every_calibration_has_its_number():
    for camera in CAMERAS:
        text = (camera_folder() / f"{camera}.toml").read_text(encoding="utf-8")
        stated = sum(number.get("calibrated", False) for number in NUMBERS if number["camera"] == camera)
        assert text.count("calibrated (against") == stated, camera


def test_the_page_has_the_numbers_of_today():
    text = PAGE.read_text(encoding="utf-8")
    assert with_table(text) == text


def test_the_largest_differences_are_explained():
    """Those of a third or more, with their ratios of today."""
    rows = re.findall(r"(?m)^\| `(\S+)` \| ([\d.]+) \|", PAGE.read_text(encoding="utf-8").split("## Largest")[1])
    ratios = [(number["camera"], ours(number) / number["value"]) for number in NUMBERS]
    large = {(camera, f"{ratio:.2f}") for camera, ratio in ratios if not 2 / 3 < ratio < 3 / 2}
    assert large <= set(rows) <= {(camera, f"{ratio:.2f}") for camera, ratio in ratios}


def test_there_are_ten_cameras_or_more():
    assert len(CAMERAS) >= 10
    assert {number["camera"] for number in NUMBERS} <= set(CAMERAS)


@pytest.mark.parametrize("camera", CAMERAS)
def test_each_value_of_a_camera_has_a_source(camera):
    """A comment at each value of the instrument and the observations; its letters are sources of the head."""
    head, _, body = (camera_folder() / f"{camera}.toml").read_text(encoding="utf-8").partition("\ntitle")
    assert (load_bands if has_bands(camera) else load_scene)(camera).name == camera and '"assumed" says' in head
    for section in re.split(r"(?m)^(?=\[)", body)[1:]:
        for line in section.splitlines()[1:]:
            value, _, comment = line.partition(" # ")
            assert comment or not value or section.startswith("[score.signal_sims]"), line
            for letter in re.findall(r"(?:^|[(,;] ?)([A-Z])(?=[,:;)]|$)", comment):
                assert re.search(rf"\b{letter} is ", head), line


@pytest.mark.parametrize("camera", CAMERAS)
def test_cameras_have_no_published_scores(camera):
    content = tomllib.loads((camera_folder() / f"{camera}.toml").read_text(encoding="utf-8"))
    keys = {key for key, _ in scene_keys(content)}
    assert "score.size" in keys and not any(key.startswith("score.reference") for key in keys)


@pytest.mark.slow
@pytest.mark.parametrize("camera", CAMERAS)
def test_cameras_run(camera, tmp_path):
    """With half the scans at twice the distance, which covers the field."""
    load = load_bands if has_bands(camera) else load_scene
    scene = load(camera)
    scan = (next(iter(scene.bands.values())) if has_bands(camera) else scene).scan
    settings = {
        "observations": 2,
        "scan.scans": scan.scans // 2,
        "scan.step": f"{2 * scan.step_rad} rad",
        "score.jackknives": 8,
        "score.signal_sims.skies": 2,
        "score.signal_sims.observations": 1,
    }
    run(load(camera, settings), tmp_path / "out", engine=SERIAL, figures=False)
    assert (tmp_path / "out" / "summary.json").is_file()
