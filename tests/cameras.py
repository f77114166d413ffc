"""A small camera of two bands, for tests that need several."""

from pathlib import Path

from surveysim.scene.bands import load_bands
from surveysim.scene.kinds import has_bands
from surveysim.scene.scene import Scene, load_scene
from tests.scenes import SMALL_SCENE, without_sections

_B2 = 'b2_probabilities = [0.25, 0.5, 0.75]\nb2 = "[100, 280, 980] mK2 rad(-5/3)"\n'
_COMMON = SMALL_SCENE.replace(_B2, 'site = "mauna_kea"\n').replace('frequency = "143 GHz"\n', "bandwidth = 0.15\n")
_COMMON = _COMMON.replace("mask_separation_f_lambda = 1.3\n", "")

# The second band has fewer detectors at the same pitch, and a narrower beam.
BANDS = """
[bands.150.instrument]
frequency = "150 GHz"

[bands.220.instrument]
frequency = "220 GHz"
beam_fwhm = "40 arcsec"

[bands.220.instrument.layout]
rings = 1

[bands.220.detector]
psd = "4 mK2 / Hz"
"""
TWO_BANDS = _COMMON + BANDS
# The layer alone.
LAYER_BANDS = without_sections(_COMMON, "excess", "photon", "detector", "sky", "score") + BANDS.replace(
    '\n[bands.220.detector]\npsd = "4 mK2 / Hz"\n', ""
)


def write_camera(folder: Path, text: str = TWO_BANDS) -> Path:
    """Write a camera named two; returns its path."""
    path = folder / "two.toml"
    path.write_text(text)
    return path


def scenes_of(path: Path) -> list[Scene]:
    """The scene of a file, or those of its bands."""
    return list(load_bands(path).bands.values()) if has_bands(path) else [load_scene(path)]
