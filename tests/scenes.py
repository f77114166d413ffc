"""A small scene with every stage, for tests that need one: a survey of it takes about a second."""

from pathlib import Path

SMALL_SCENE = """\
title = "A small camera over a small field"
seed = 11
observations = 4

[field]
ra = "08h49m12s"
dec = "+44d50m24s"

[fixed_pointing]
elevation = "55 deg"
parallactic_angle = "20 deg"

[instrument]
frequency = "143 GHz"
beam_fwhm = "60 arcsec"
f_lambda = "57.142857 arcsec"
responsivity_scatter = 0.05
camera_rotation_range = "60 deg"

[instrument.layout]
rings = 2
pitch_f_lambda = 0.7
dead = [5]

[scan]
speed = "4 arcmin / s"
scans = 4
duration = "6 s"
turnaround = "2 s"
step = "3 arcmin"
dither = "2 arcmin"
sample_rate = "10 Hz"

[atmosphere]
spectral_index = "11/3"
layer_height = "1000 m"
illuminated_aperture = "8 m"
b2_probabilities = [0.25, 0.5, 0.75]
b2 = "[100, 280, 980] mK2 rad(-5/3)"
wind_median = "31 arcmin / s"
wind_log_scatter = 0.4

[excess]
spectral_index = 1.0
band_limit = "1 Hz"
b2 = [46, 580]
variance = "[2.05, 4.52] mK2"
coherence = "field"

[photon]
psd = "2.5 mK2 / Hz"
coherent_fraction = 0.1
coherence = "field"

[detector]
psd = "2.5 mK2 / Hz"

[sky]
cmb_band_power = "1000 uK2"

[[sky.point_sources]]
ra = "08h49m20s"
dec = "+44d51m00s"
peak = "5 mK"

[cleaning]
algorithm = "average"
tolerance = 1e-8
max_iterations = 100

[map]
pixel = "30 arcsec"

[score]
size = "12 arcmin"
taper_fraction = 0.5
ell_bin = 2000
ell_min = 4000
ell_max = 12000
jackknives = 4
white_noise_above = "2.5 Hz"
mask_separation_f_lambda = 1.3
noise_only_sets = ["uncorrelated", "white"]

[score.signal_sims]
skies = 2
observations = 2
band_power = "1000 uK2"
"""


def write_scene(folder: Path, text: str = SMALL_SCENE) -> Path:
    """Write a scene named small; returns its path."""
    path = folder / "small.toml"
    path.write_text(text)
    return path


def without_sections(text: str, *names: str) -> str:
    """The scene less some sections and what lies below them."""
    kept, leave_out = [], False
    for line in text.splitlines(keepends=True):
        if line.startswith("["):
            leave_out = line.strip("[]\n").split(".")[0] in names
        if not leave_out:
            kept.append(line)
    return "".join(kept)


# Keys of the small scene for a patch of 36 arcmin in bright weather, in which scans are hardly ever lost.
WIDE_PATCH = {
    "scan.scans": 19,
    "scan.step": "2 arcmin",
    "scan.duration": "12 s",
    "instrument.layout.rings": 3,
    "map.pixel": "20 arcsec",
    "atmosphere.b2": "[400, 900, 2000] mK2 rad(-5/3)",
    "score.size": "36 arcmin",
    "score.ell_bin": 1000,
    "score.jackknives": 32,
}

# Weather in which no scan is too calm to fit responsivities on.
TURBULENT_SCENE = SMALL_SCENE.replace("[100, 280, 980] mK2", "[1000, 2800, 9800] mK2")

# In place of [fixed_pointing].
SCHEDULE = """
[schedule]
latitude = "19.8 deg"
longitude = "-155.5 deg"
height = "4070 m"
first_night = "2003-10-28"
nights = 1
max_hour_angle = "3 hourangle"
min_elevation = "40 deg"
"""

# Splits of its data, with band powers and null tests.
SPECTRA = """
[spectra]
splits = ["night", "direction", "array"]
parts = 2
ell_bin = 2000
realizations = 16
"""

WHITE_NOISE_SCENE = without_sections(SMALL_SCENE, "atmosphere", "excess", "photon", "sky", "score").replace(
    'algorithm = "average"', 'algorithm = "none"'
)


def with_scan(text: str, keys: str) -> str:
    """The scene with other keys in its section [scan]."""
    before, _, rest = text.partition("[scan]\n")
    return f"{before}[scan]\n{keys}\n{rest[rest.index('[') :]}"
