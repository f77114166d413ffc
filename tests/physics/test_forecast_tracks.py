"""Forecasts of curved tracks and of several layers against simulated surveys."""

from functools import cache

import pytest

from surveysim import run
from surveysim.results.agreement import forecast_agreement
from surveysim.runtime.engine import SERIAL
from surveysim.scene.scene import load_scene
from tests.scenes import SMALL_SCENE, WIDE_PATCH, with_scan, without_sections

COMMON = 'dither = "4 arcmin"\nsample_rate = "10 Hz"\n'
CHUNKS = 'duration = "240 s"\nchunk = "12 s"\n' + COMMON
PATTERNS = {
    "raster": 'speed = "6 arcmin / s"\nscans = 30\nduration = "8 s"\nturnaround = "2 s"\nstep = "1.3 arcmin"\n'
    + COMMON,
    "azimuth": 'pattern = "azimuth"\nspeed = "6 arcmin / s"\nthrow = "48 arcmin"\nscans = 24\nturnaround = "2 s"\n'
    + COMMON,
    "daisy": 'pattern = "daisy"\nradius = "22 arcmin"\nradial_period = "24 s"\n' + CHUNKS,
    "lissajous": 'pattern = "lissajous"\namplitude_x = "20 arcmin"\namplitude_y = "20 arcmin"\nperiod_x = "21 s"\n'
    'period_y = "23.7 s"\n' + CHUNKS,
    "pong": 'pattern = "pong"\nwidth = "40 arcmin"\nheight = "40 arcmin"\nspacing = "3 arcmin"\n'
    'velocity = "6 arcmin / s"\nterms = 5\n' + CHUNKS,
}
SCHEDULE = """\
[schedule]
latitude = "19.8 deg"
longitude = "204.5 deg"
height = "4000 m"
first_night = "2004-05-01"
nights = 60
max_hour_angle = "60 deg"
min_elevation = "35 deg"

"""
LAYERS = """\
[[atmosphere.layers]]
name = "low"
height = "500 m"
share = 0.3

[[atmosphere.layers]]
name = "middle"
height = "1000 m"
share = 0.5
wind_turn = "60 deg"

[[atmosphere.layers]]
name = "high"
height = "2500 m"
share = 0.2
wind_turn = "180 deg"
wind_factor = 1.5

"""
KEYS = {key: value for key, value in WIDE_PATCH.items() if not key.startswith("scan.")} | {
    "score.size": "30 arcmin",
    "map.pixel": "25 arcsec",
    "instrument.layout.rings": 4,
    "observations": 32,
    "score.noise_only_sets": [],
    "score.signal_sims.observations": 16,
}
WITHIN, KNOWN = 0.1, 0.07  # of sigma(A): largest difference, and its largest standard error
QUIET = {"photon.psd": "0.02 mK2 / Hz", "detector.psd": "0.02 mK2 / Hz", "excess": None}


def scene_text(pattern: str, layers: bool) -> str:
    """A small camera without a mask or a sky, at a fixed pointing unless the pattern needs a horizon."""
    text = without_sections(SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", ""), "sky")
    text = with_scan(text, PATTERNS[pattern])
    if pattern == "azimuth":
        before, _, rest = text.partition("[fixed_pointing]\n")
        text = before + SCHEDULE + rest[rest.index("[") :]
    return text.replace("[excess]", LAYERS + "[excess]") if layers else text


@cache
def agreement(folder, pattern: str, layers: bool = False, keys: tuple = ()):
    """Forecast over simulation of the actual data, and the names of flagged effects."""
    path = folder / f"{pattern}.toml"
    path.write_text(scene_text(pattern, layers))
    result = run(load_scene(path, KEYS | dict(keys)), engine=SERIAL)
    flagged = [effect.name for effect in result.expected.scores["actual"].effects if effect.flagged]
    return forecast_agreement(result)["actual"], flagged


@pytest.fixture
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tracks")


@pytest.mark.slow
@pytest.mark.parametrize(
    "pattern, layers, keys",
    [
        ("raster", True, {"cleaning.algorithm": "planar", "atmosphere.decorrelation_time": "10 s"}),
        ("azimuth", False, {}),
        ("daisy", False, {}),
        ("lissajous", True, {}),
        ("pong", False, {"cleaning.algorithm": "planar"}),
    ],
)
def test_forecasts_of_tracks_are_as_simulated(folder, pattern, layers, keys):
    """Within 10 %, or two errors of the simulation; only the daisy's uneven coverage is flagged."""
    found, flagged = agreement(folder, pattern, layers, tuple(keys.items()))
    assert found.sigma_error < KNOWN
    assert abs(found.sigma) < max(WITHIN, 2 * found.sigma_error)
    assert flagged == (["uneven coverage"] if pattern == "daisy" else [])


@pytest.mark.slow
def test_a_layer_far_above_the_other_noise_is_flagged(folder):
    """Along a Lissajous figure its large structures scatter to the scored multipoles: a third of sigma(A) or more."""
    found, flagged = agreement(folder, "lissajous", False, tuple(QUIET.items()))
    assert found.sigma < -0.2 and "scattered noise" in flagged
