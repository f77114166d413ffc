"""Warnings about the design of a survey: each appears beyond its limit, and none within."""

import json

import pytest

from surveysim.api import run
from surveysim.reduction.design_warnings import CHECKS, design_warnings
from surveysim.reduction.setup import prepare
from surveysim.report.terminal.survey import print_result
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene
from tests.pages import read_page
from tests.scenes import write_scene

OFF = {"instrument.layout": None, "instrument.wafers": [{"rings": 2, "pitch_f_lambda": 0.7, "offset_x": "9 arcmin"}]}
NEAR = {"instrument.layout": None, "instrument.wafers": [{"rings": 2, "pitch_f_lambda": 0.7, "offset_x": "1 arcmin"}]}
# The small scene: samples 24 arcsec apart, a beam of 60 and pixels of 30; scans of 24 arcmin, 9 arcmin across, a dither
# of 2 arcmin, and an array of 2.67 arcmin.
CASES = {
    "sampling": (
        {"scan.sample_rate": "7.9 Hz"},
        {"scan.sample_rate": "8 Hz"},
        "scan.sample_rate: samples are 30.4 arcsec apart, more than half of the beam of 60 arcsec; a rate of 8 Hz or",
    ),
    "diffraction": (
        {"instrument.f_lambda": "60.1 arcsec"},
        {"instrument.f_lambda": "60 arcsec"},
        "instrument.beam_fwhm: the beam of 60 arcsec is narrower than lambda/D = 60.1 arcsec",
    ),
    "pixels": (
        {"map.pixel": "31 arcsec"},
        {"map.pixel": "30 arcsec"},
        "map.pixel: pixels of 31 arcsec are larger than half of the beam of 60 arcsec.",
    ),
    "coverage": (
        {"score.size": "13.8 arcmin"},
        {"score.size": "13.6 arcmin"},
        "score.size: the scored patch of 13.8 arcmin is larger than the 13.7 arcmin that scans in both directions",
    ),
    "boresight": (OFF, NEAR, "instrument: the middle of the array is 9 arcmin off the boresight, beyond its own half"),
}


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def test_every_check_has_a_case():
    assert len(CASES) == len(CHECKS)


@pytest.mark.parametrize("name", CASES)
def test_a_warning_beyond_a_limit(path, name):
    beyond, within, words = CASES[name]
    (line,) = design_warnings(prepare(load_scene(path, beyond)))
    assert line.startswith(words) and line.endswith(".") and "\n" not in line
    assert design_warnings(prepare(load_scene(path, within))) == []


def test_the_narrowest_beam_counts(path, tmp_path):
    import astropy.units as u
    from astropy.table import QTable

    x = [0, 40, 80, 120, 0, 40, 80, 120] * u.arcsec
    y = [0, 0, 0, 0, 40, 40, 40, 40] * u.arcsec
    QTable({"x": x, "y": y, "beam_fwhm": [60, 60, 60, 60, 60, 60, 60, 58] * u.arcsec}).write(tmp_path / "camera.ecsv")
    table = {"instrument.layout": None, "instrument.positions": "camera.ecsv", "score.mask_separation_f_lambda": None}
    (line,) = design_warnings(prepare(load_scene(path, table)))
    assert line == "map.pixel: pixels of 30 arcsec are larger than half of the beam of 58 arcsec."


def test_a_run_with_a_warning_says_so_everywhere(path, tmp_path, capsys):
    """On the terminal, in summary.json and on the report page; it is a run like any other."""
    result = run(load_scene(path, CASES["pixels"][0]), tmp_path / "out", engine=SERIAL, figures=False)
    print_result(result, tmp_path / "out")
    words = CASES["pixels"][2]
    assert words in " ".join(capsys.readouterr().out.split())
    assert words in json.loads((tmp_path / "out" / "summary.json").read_text())["warnings"]
    assert words in " ".join(read_page(tmp_path / "out" / "report.html").one("header").text.split())
