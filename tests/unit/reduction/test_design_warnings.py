"""Warnings about the design of a survey: each appears beyond its limit, and none within."""

import json
import re
import tomllib

import numpy as np
import pytest

from surveysim import run
from surveysim.reduction.design_warnings import CHECKS, design_warnings
from surveysim.reduction.setup import prepare
from surveysim.report.terminal.survey import print_result
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene
from surveysim.scene.units import BOLTZMANN_J_K, CMB_TEMPERATURE_K, PLANCK_J_S
from tests.pages import read_page
from tests.scenes import SCHEDULE, write_scene

OFF = {"instrument.layout": None, "instrument.wafers": [{"rings": 2, "pitch_f_lambda": 0.7, "offset_x": "9 arcmin"}]}
NEAR = {"instrument.layout": None, "instrument.wafers": [{"rings": 2, "pitch_f_lambda": 0.7, "offset_x": "1 arcmin"}]}
TABLE = {
    "instrument.layout": None,
    "score.mask_separation_f_lambda": None,
    "instrument.responsivity_scatter": 0,
    "detector.psd": "2.5 mK2 / Hz",
}
ANGLES = TABLE | {"instrument.positions": "angles.ecsv", "instrument.polarizations": 1}
ANGLES |= {"photon.coherence": "hbt", "photon.bose_fraction": 0.5}
EFFICIENT = TABLE | {"instrument.positions": "efficient.ecsv", "detector.psd": None}
ELEMENT = {"name": "window", "side": "sky", "temperature": "270 K", "transmission": 0.9}
# A filter that passes 1 at 123 GHz and 0.1 at 163 GHz.
FILTER = {
    "photon.psd": None,
    "photon.coherent_fraction": None,
    "optics.sky": "20 K",
    "optics.elements": [ELEMENT | {"transmission": "filter.ecsv", "emissivity": 0}],
    "instrument.efficiency": 0.4,
    "instrument.polarizations": 1,
}
NIGHTS = {f"schedule.{key}": value for key, value in tomllib.loads(SCHEDULE)["schedule"].items()}
NIGHTS |= {"fixed_pointing": None, "observations": 48, "atmosphere.correlation_time": "2 h"}
# Radial speeds of up to 6 arcmin times 2 pi over 10 s, 3.77 arcmin/s.
DAISY = {f"scan.{key}": None for key in ("speed", "scans", "turnaround", "step")}
DAISY |= {"scan.pattern": "daisy", "scan.radius": "6 arcmin", "scan.radial_period": "10 s"}
DAISY |= {"scan.duration": "1 min", "scan.chunk": "10 s"}
# Rows each second, but for one of 10.1 s and one of 9.9 s.
TRACK = {f"scan.{key}": None for key in ("speed", "scans", "turnaround", "step", "duration")}
TRACK |= {"scan.pattern": "track", "scan.chunk": "10 s", "score": None}
TRACK_TIMES = {"long.csv": 50.1, "short.csv": 49.9}
SCORED_TRACK = {key: value for key, value in TRACK.items() if key != "score"} | {"scan.track_table": "short.csv"}
SPLITS = {"spectra.splits": ["night"], "spectra.parts": 2, "spectra.ell_bin": 2000, "spectra.realizations": 7}
SPLITS |= {"observations": 16}
# The small scene: samples 24 arcsec apart, a beam of 60 and pixels of 30; scans of 24 arcmin, 9 arcmin across, a dither
# of 2 arcmin, and an array of 2.67 arcmin.
CASES = {
    "realizations": (
        SPLITS | {"spectra.realizations": 6},
        SPLITS,
        "spectra.realizations: 6 realizations do not measure the covariance of 4 bins; 7 or more are needed for a chi",
    ),
    # Bins of 6 s above 2.5 Hz begin at 2.67 Hz: 4 of their 28 cosines are below 3 Hz, and 2 are a line.
    "filtered white": (
        {"cleaning.algorithm": ["average", "highpass"], "cleaning.highpass_frequency": "3 Hz"},
        {
            "cleaning.algorithm": ["average", "highpass", "notch"],
            "cleaning.highpass_frequency": "0.5 Hz",
            "cleaning.notch_frequencies": "[1.5] Hz",
            "cleaning.notch_widths": "[0] Hz",
        },
        "score.white_noise_above: filters of cleaning.algorithm remove 14 % of the noise above 2.5 Hz, and",
    ),
    # The beam of 60 arcsec is 0.29 m wide at the layer.
    "two apertures": (
        {"optics.aperture": "9 m"},
        {"optics.aperture": "8.3 m"},
        "atmosphere.illuminated_aperture: pixels see the layer with 8 m, and optics.aperture is 9 m; they are usually",
    ),
    "sampling": (
        {"scan.sample_rate": "7.9 Hz"},
        {"scan.sample_rate": "8 Hz"},
        "scan.sample_rate: samples are 30.4 arcsec apart, more than half of the beam of 60 arcsec; a rate of 8 Hz or",
    ),
    "track gap": (
        TRACK | {"scan.track_table": "long.csv"},
        TRACK | {"scan.track_table": "short.csv"},
        "scan.track_table: row 42 is 10.1 s after the row before, and most rows 1 s; samples between are interpolated",
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
    "turning raster": (
        NIGHTS | {"schedule.nights": 16, "field.dec": "19.3 deg", "sky": None},
        NIGHTS | {"schedule.nights": 16, "field.dec": "19 deg", "sky": None},
        "scan.pattern: along the scans of observation",
    ),
    "optics": (
        {"optics.elements": [ELEMENT]},
        {"optics.aperture": "8 m"},
        "photon.psd: it sets the photon noise, and sky, stop and elements of [optics] do not enter",
    ),
    "angle": (
        ANGLES | {"photon.coherence": "field"},
        ANGLES,
        "instrument.positions: column 'angle' does not change noise with photon.coherence 'field'",
    ),
    "efficiency": (
        EFFICIENT | {"photon": None},
        EFFICIENT | {"photon.bose_fraction": 0.5},
        "instrument.positions: column 'efficiency' changes nothing without [photon]",
    ),
    "conversion": (
        FILTER | {"instrument.bandwidth": 0.25},
        FILTER | {"instrument.bandwidth": 0.1},
        "optics: NETs have 1.606 K_CMB per K_RJ, through atmosphere and optics; maps and sigma(A) have 1.653, of",
    ),
    "lost samples": (
        {"dead_time": {"detectors": 0.1, "scans": 0.12}},
        {"dead_time": {"detectors": 0.1, "scans": 0.1}},
        "[dead_time]: 21 % of the samples are lost; more than 20 % are many.",
    ),
    "spells": (
        NIGHTS | {"schedule.nights": 15},
        NIGHTS | {"schedule.nights": 16},
        "atmosphere.correlation_time: with 2 h the observations have 15 blocks of independent weather. The error of",
    ),
    "boresight": (OFF, NEAR, "instrument: the middle of the array is 9 arcmin off the boresight, beyond its own half"),
}


@pytest.fixture
def path(tmp_path):
    import astropy.units as u
    from astropy.table import QTable

    x, y = (item.ravel() * u.arcsec for item in np.meshgrid([0, 40, 80, 120], [0, 40]))
    QTable({"x": x, "y": y, "angle": np.arange(8) * 20 * u.deg}).write(tmp_path / "angles.ecsv")
    columns = {"psd": np.full(8, 2.5) * u.mK**2 / u.Hz, "efficiency": np.linspace(0.9, 1.1, 8)}
    QTable({"x": x, "y": y} | columns).write(tmp_path / "efficient.ecsv")
    filtered = {"frequency": [123, 163] * u.GHz, "transmission": [1, 0.1]}
    QTable(filtered).write(tmp_path / "filter.ecsv")
    for name, after in TRACK_TIMES.items():
        rows = [f"{t}, {132.3 + t / 500}, 44.84\n" for t in [*range(41), *(after + np.arange(12))]]
        (tmp_path / name).write_text("".join(["time [s], ra [deg], dec [deg]\n", *rows]))
    return write_scene(tmp_path)


MORE = {
    "filtered white by a notch": (
        {
            "cleaning.algorithm": ["average", "notch"],
            "cleaning.notch_frequencies": "[3] Hz",
            "cleaning.notch_widths": "[0] Hz",
        },
        {"cleaning.highpass_frequency": "3 Hz"},
        "score.white_noise_above: filters of cleaning.algorithm remove 7 % of the noise above 2.5 Hz, and the measured",
    ),
    "parts": (
        SPLITS | {"observations": 15},
        SPLITS,
        "spectra: a part has 7 observations; 8 or more are needed to trust the errors of band powers and null tests.",
    ),
    "track": (
        SCORED_TRACK | {"score.size": "4.7 arcmin"},
        SCORED_TRACK | {"score.size": "4.6 arcmin"},
        "score.size: the scored patch of 4.7 arcmin is larger than the 4.67 arcmin that the boresight reaches along an",
    ),
    "fastest": (
        DAISY | {"scan.sample_rate": "7.5 Hz"},
        DAISY | {"scan.sample_rate": "7.6 Hz"},
        "scan.sample_rate: samples are 30.2 arcsec apart, more than half of the beam of 60 arcsec; a rate of 7.54 Hz",
    ),
    "daisy": (
        DAISY | {"score.size": "16.7 arcmin"},
        DAISY | {"score.size": "16.6 arcmin"},
        "score.size: the scored patch of 16.7 arcmin is larger than the 16.7 arcmin that the daisy covers (12 arcmin,",
    ),
}


def test_every_check_has_a_case():
    assert len(CASES) == len(CHECKS)


@pytest.mark.parametrize("name", [*CASES, *MORE])
def test_a_warning_beyond_a_limit(path, name):
    beyond, within, words = (CASES | MORE)[name]
    (line,) = design_warnings(prepare(load_scene(path, beyond)))
    assert line.startswith(words) and line.endswith(".") and "\n" not in line
    assert design_warnings(prepare(load_scene(path, within))) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"photon": None}, "without [photon]"),
        ({"instrument.polarizations": 2}, "with instrument.polarizations = 2"),
        ({"photon.coherence": "none"}, "with photon.coherence 'none'"),
    ],
)
def test_noise_that_angles_do_not_change(path, change, words):
    (line,) = design_warnings(prepare(load_scene(path, ANGLES | change)))
    assert words in line


def test_both_conversions_to_cmb_temperature(path):
    """That of maps is the mean of dB/dT over the band, and that of NETs is weighted by the filter."""
    (line,) = design_warnings(prepare(load_scene(path, CASES["conversion"][0])))
    nu = np.linspace(143e9 * 0.875, 143e9 * 1.125, 4001)
    x = PLANCK_J_S * nu / (BOLTZMANN_J_K * CMB_TEMPERATURE_K)
    response, passed = np.exp(x) * (x / np.expm1(x)) ** 2, np.interp(nu, [123e9, 163e9], [1, 0.1])
    found = [float(number) for number in re.findall(r"have ([\d.]+)", line)]
    assert found == pytest.approx([passed.sum() / (passed @ response), len(nu) / response.sum()], rel=1e-3)


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
