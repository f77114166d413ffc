"""A stress case: its definition, how it is run, and its outcome."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mapmaker.cleaning import TemplateOptions
from surveysim.runtime.errors import InputError
from surveysim.scene.scene import Scene, scene_of

RATE_HZ = 10.0
N_SAMP = 150
# Amplitude of the atmosphere over the white noise.
STIFF = 1e6
# Largest rms rounding error of a float32 sample, relative to its size.
QUANTUM = 2.0**-24 / math.sqrt(3)
TEMPLATES = TemplateOptions(1e-8, 100)


@dataclass(frozen=True)
class Outcome:
    """Outcome of a case.

    Attributes
    ----------
    found, expected
        Numbers, or the texts of refusals.
    tolerance
        Largest absolute difference that passes.
    ok
        The case passed.
    note
        Unit or details.
    """

    found: float | str
    expected: float | str
    tolerance: float
    ok: bool
    note: str = ""


@dataclass(frozen=True)
class Case:
    """A stress case: `check` computes the outcome from the base scene with `overrides`.

    `why` is the expected answer and its reason; `refusal` are words of the error message, if an error is the right
    answer.
    """

    name: str
    why: str
    check: Callable[[Scene], Outcome]
    overrides: Mapping[str, Any] = field(default_factory=dict)
    refusal: str = ""
    slow: bool = False


def base_scene(overrides: Mapping[str, Any]) -> Scene:
    """Load a scene of 37 detectors that make four scans under the atmosphere; `overrides` and errors as for
    `load_scene`.
    """
    return scene_of(Path("extremes.toml"), "", _BASE, overrides)


def run_case(case: Case) -> Outcome:
    """Run a case.

    Returns
    -------
    Outcome; a refusal (InputError) is an outcome too.
    """
    try:
        outcome = case.check(base_scene(case.overrides))
    except InputError as error:
        refused = bool(case.refusal) and case.refusal in str(error)
        return Outcome(str(error), case.refusal or "an answer", 0.0, refused, "refused")
    if case.refusal:
        return replace(outcome, expected=f"refusal: {case.refusal}", ok=False)
    return outcome


_BASE = {
    "title": "A camera at the edge",
    "seed": 5,
    "observations": 4,
    "field": {"ra": "08h49m12s", "dec": "+44d50m24s"},
    "fixed_pointing": {"elevation": "55 deg", "parallactic_angle": "20 deg"},
    "instrument": {
        "frequency": "143 GHz",
        "beam_fwhm": "60 arcsec",
        "f_lambda": "57 arcsec",
        "responsivity_scatter": 0.05,
        "camera_rotation_range": "60 deg",
        "layout": {"rings": 3, "pitch_f_lambda": 0.7},
    },
    "scan": {
        "speed": "4 arcmin / s",
        "scans": 4,
        "duration": "15 s",
        "turnaround": "2 s",
        "step": "3 arcmin",
        "dither": "2 arcmin",
        "sample_rate": "10 Hz",
    },
    "atmosphere": {
        "spectral_index": "11/3",
        "layer_height": "1000 m",
        "illuminated_aperture": "8 m",
        "b2_probabilities": [0.5],
        "b2": "[280] mK2 rad(-5/3)",
        "wind_median": "31 arcmin / s",
        "wind_log_scatter": 0,
    },
    "excess": {
        "spectral_index": 1.0,
        "band_limit": "1 Hz",
        "b2": [280],
        "variance": "[3] mK2",
        "coherence": "field",
    },
    "detector": {"psd": "5 mK2 / Hz"},
    "cleaning": {"algorithm": "average", "tolerance": 1e-8, "max_iterations": 100, "sigma_cut": 3.0},
    "map": {"pixel": "30 arcsec"},
}


def agrees(found: float, expected: float, tolerance: float, note: str = "") -> Outcome:
    """Make the outcome of a number with an expected value and a tolerance."""
    # Written so that NaN fails.
    return Outcome(float(found), float(expected), float(tolerance), bool(abs(found - expected) <= tolerance), note)
