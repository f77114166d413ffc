"""Extreme values of all keys of a scene, from its schema: least, most and decades in between."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from surveysim.scene.keys import all_keys
from surveysim.scene.units import to_float

POWER = {"instrument.bandwidth": 0.15, "instrument.efficiency": 0.2, "instrument.polarizations": 2}
LOAD = POWER | {"photon.psd": None, "photon.coherent_fraction": None}
OPTICS = LOAD | {"optics.sky": "10 K"}
BOLOMETER = {
    "detector.bolometer.conductance": "100 pW / K",
    "detector.bolometer.critical_temperature": "165 mK",
    "detector.bolometer.bath_temperature": "100 mK",
    "detector.bolometer.exponent": 3,
    "detector.bolometer.amplifier_nep": "1e-17 W / Hz(1/2)",
}
KID = {
    "detector.kid.gap": "0.19 meV",
    "detector.kid.pair_breaking_efficiency": 0.4,
    "detector.kid.amplifier_nep": "1e-17 W / Hz(1/2)",
}
PLACE = {"latitude": "19.8 deg", "longitude": "-155.5 deg", "height": "4070 m"}
SITE = (
    {f"site.{key}": value for key, value in PLACE.items()}
    | {f"schedule.{key}": None for key in PLACE}
    | {"atmosphere.pwv": "[1] mm", "atmosphere.pwv_probabilities": [0.5], "instrument.bandwidth": 0.15}
)
GLITCHES = {"glitches.rate": "1e-3 Hz", "glitches.amplitude": "10 mK", "glitches.decay_time": "0.1 s"}
GAPS = {"dropped_samples.rate": "1e-3 Hz", "dropped_samples.length": "1 s", "dropped_samples.shared": "array"}
SPLITS = {"spectra.splits": ["night"], "spectra.parts": 2, "spectra.ell_bin": 1000, "spectra.realizations": 4}
# What a key needs beside it to be in a scene that has another in its place.
BESIDE: dict[str, Mapping[str, Any]] = {
    "instrument.layout.field_of_view": {"instrument.layout.rings": None, "instrument.layout.dead": []},
    "instrument.layout.rings": {"instrument.layout.dead": []},
    "cleaning.calibration_error": {"cleaning.responsivities": "survey"},
    "cleaning.sigma_cut": {"cleaning.algorithm": "pca"},
    "cleaning.neighbour_radius": {"cleaning.algorithm": "local"},
    "cleaning.order": {"cleaning.algorithm": "polynomial", "cleaning.regions": 1},
    "cleaning.pca_modes": {"cleaning.algorithm": "pca", "cleaning.pca_criterion": "modes"},
    "cleaning.pca_variance": {"cleaning.algorithm": "pca", "cleaning.pca_criterion": "variance"},
    "cleaning.pca_criterion": {"cleaning.algorithm": "pca", "cleaning.sigma_cut": 3.0, "cleaning.pca_modes": 1}
    | {"cleaning.pca_variance": 0.5},
    "cleaning.highpass_frequency": {"cleaning.algorithm": ["highpass", "average"]},
    "cleaning.highpass_order": {"cleaning.algorithm": ["highpass", "average"], "cleaning.highpass_frequency": "0.1 Hz"},
    "cleaning.time_order": {"cleaning.algorithm": ["time_polynomial", "average"]},
    "cleaning.regions": {"cleaning.algorithm": "polynomial", "cleaning.order": 1},
    "photon.bose_fraction": {"photon.coherence": "hbt"},
    "sky.curved_lmax": {"sky.cmb_band_power": "1000 uK2"},
    "photon.load.sky": LOAD | {"photon.load.optics": "1 K"},
    "photon.load.optics": LOAD | {"photon.load.sky": "1 K"},
    "detector.nep": POWER | {"detector.psd": None},
    **{key: POWER | BOLOMETER | {"detector.psd": None} for key in BOLOMETER},
    **{key: OPTICS | KID | {"detector.psd": None} for key in KID},
    **{f"site.{key}": SITE for key in (*PLACE, "temperature")},
    "optics.sky": OPTICS,
    **{f"glitches.{key}": GLITCHES for key in ("slope", "found", "threshold")},
    **{f"dropped_samples.{key}": GAPS for key in ("rate", "length", "shared")},
    **{f"glitches.{key}": GLITCHES for key in ("rate", "amplitude", "decay_time")},
    **{key: SPLITS for key in SPLITS},
    "optics.stop.temperature": OPTICS | {"instrument.horn_f_lambda": 0.7},
    "optics.central_obscuration": OPTICS | {"optics.aperture": "10 m"},
    "optics.aperture_efficiency": OPTICS | {"optics.aperture": "10 m"},
    "responsivity_drift.rms": {"responsivity_drift.time_scale": "1 day"},
    "responsivity_drift.time_scale": {"responsivity_drift.rms": 0.01},
    "responsivity_drift.load_scatter": {"responsivity_drift.load_coefficient": "0.01 / K"},
    "responsivity_drift.calibration_elevation": {"responsivity_drift.load_coefficient": "0.01 / K"},
    "time_constants.scatter": {"time_constants.value": "1 ms"},
    "time_constants.deconvolution_error": {"time_constants.value": "1 ms"},
    "crosstalk.group_size": {"crosstalk.group_fraction": 0.01},
    "pointing_errors.jitter_bandwidth": {"pointing_errors.jitter": "1 arcsec"},
    "pointing_errors.drift": {"pointing_errors.drift_time_scale": "1 day"},
    "pointing_errors.drift_time_scale": {"pointing_errors.drift": "1 arcsec"},
    "atmosphere.profile": {"atmosphere.water_scale_height": "2 km"},
    "atmosphere.profile_layers": {"atmosphere.profile": "exponential", "atmosphere.water_scale_height": "2 km"},
    "atmosphere.water_scale_height": {"atmosphere.profile": "exponential"},
    "atmosphere.wind_drift.speed_rms": {"atmosphere.wind_drift.time_scale": "1 day"},
    "atmosphere.wind_drift.direction_rms": {"atmosphere.wind_drift.time_scale": "1 day"},
    "atmosphere.wind_drift.time_scale": {"atmosphere.wind_drift.speed_rms": 0.1},
    "fixed_pointing.elevation": {"schedule": None, "fixed_pointing.parallactic_angle": "10 deg"},
    "fixed_pointing.parallactic_angle": {"schedule": None, "fixed_pointing.elevation": "50 deg"},
}
# Lists, and numbers in tables that a scene has any number of: unit tests have their own of these.
LISTS = (
    "atmosphere.layers.",
    "score.metrics.",
    "optimise.",
    "optics.elements.",
    "sky.point_sources.",
    "score.reference.",
)


def bounds(item: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Least and most of a number by the schema, in its unit."""
    least = next((item[name] for name in ("at_least", "minimum", "exclusiveMinimum") if name in item), None)
    most = next((item[name] for name in ("at_most", "maximum", "exclusiveMaximum") if name in item), None)
    unit = item.get("unit", "")
    return tuple(to_float(value, unit) if isinstance(value, str) else value for value in (least, most))


def is_number(item: Mapping[str, Any]) -> bool:
    """Whether a key has one number, with or without a unit."""
    kinds = item["type"] if isinstance(item["type"], list) else [item["type"]]
    return "enum" not in item and "array" not in kinds and bool({"integer", "number"} & {*kinds} or "unit" in item)


def extreme_values(item: Mapping[str, Any], n: int) -> list[Any]:
    """Values of a key as in a file: its choices, or least, most, and `n` in between evenly in logarithms."""
    if "enum" in item:
        return list(item["enum"])
    if not is_number(item) or item["type"] == "object":
        return []
    least, most = bounds(item)
    found = [least, most]
    if most > 0:
        smallest = least if least > 0 else 1 if item["type"] == "integer" else most * 1e-18
        found += [*np.geomspace(smallest, most, n + 2)[1:-1]] + ([smallest] if least <= 0 else [])
    if item["type"] == "integer":
        return list(dict.fromkeys(int(round(value)) for value in found))
    return [f"{value:.15g} {item['unit']}" if "unit" in item else float(value) for value in dict.fromkeys(found)]


def extreme_overrides(n: int) -> Iterator[tuple[str, dict[str, Any]]]:
    """For every key, and each of its extreme values, the overrides that make a scene with it of another."""
    for key, item in all_keys().items():
        for value in () if key.startswith(LISTS) else extreme_values(item, n):
            keys = {**BESIDE.get(key, {}), key: value}
            if key == "atmosphere.spectral_index":
                power = 2 - Fraction(str(value)).limit_denominator(1000)
                quantiles = {"b2": f"[100, 280, 980] mK2 rad({power})", "b2_probabilities": [0.25, 0.5, 0.75]}
                keys |= {"atmosphere.outer_scale": "1 km"} | {f"atmosphere.{name}": x for name, x in quantiles.items()}
            yield key, keys
