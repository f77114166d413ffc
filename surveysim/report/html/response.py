"""Sections of the detectors' response and of pointing errors in words."""

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from surveysim.report.html.quantities import arcsec
from surveysim.runtime.numbers import joined, short
from surveysim.timestreams.response import RESPONSE_STEPS, ResponseStep

Values = Mapping[str, Any]


def response_terms(scene: Values) -> dict[str, Callable[[], Iterator[str]]]:
    """Return the sentences of each section of the response, by title, from the content of scene.json."""
    present = [step for step in RESPONSE_STEPS if step.name == step.section and scene.get(step.name)]
    return {step.title: partial(_section, step, scene[step.name]) for step in present}


def _section(step: ResponseStep, section: Values) -> Iterator[str]:
    """Describe a step by its parameters, or by its one sentence."""
    if step.name in _SECTIONS:
        yield from _SECTIONS[step.name](section)
    else:
        yield f"{step.sentence[0].upper()}{step.sentence[1:]}."


def _drift(section: Values) -> Iterator[str]:
    if section["rms"]:
        yield f"Responsivities drift by {_percent(section['rms'])} rms within {short(section['time_scale_s'])} s, each"
        yield "detector by itself."
    if section["load_coefficient_per_k"]:
        scatter = f", with a scatter of {_percent(section['load_scatter'])}," if section["load_scatter"] else ""
        yield f"They fall by {_percent(section['load_coefficient_per_k'])}{scatter} for each K of load"
        elevation = section["calibration_elevation_rad"]
        where = (
            "of the observation" if elevation is None else f"at an elevation of {_rounded(math.degrees(elevation))}°"
        )
        yield f"beyond that {where}."


def _time_constants(section: Values) -> Iterator[str]:
    if section["value_s"] is None:
        yield "Those of the table of detectors."
    else:
        scatter = f" with a scatter of {_percent(section['scatter'])}" if section["scatter"] else ""
        yield f"{_rounded(1e3 * section['value_s'])} ms{scatter}."
    if section["deconvolution_error"] is not None:
        yield "Streams are deconvolved with time constants that are wrong by"
        yield f"{_percent(section['deconvolution_error'])} rms."


def _crosstalk(section: Values) -> Iterator[str]:
    parts = [
        f"{_percent(section[key])} of each stream {where}"
        for key, where in (
            ("neighbour_fraction", "in its neighbours in readout"),
            ("group_fraction", "in all others of its readout group"),
        )
        if section[key]
    ]
    size = f" Groups have {section['group_size']} detectors." if section["group_size"] else ""
    yield f"{joined(parts)}.{size}"


def _pointing_errors(section: Values) -> Iterator[str]:
    if section["jitter_rad"]:
        band = section["jitter_bandwidth_hz"]
        fast = "in each sample" if band is None else f"of a bandwidth of {short(band)} Hz"
        yield f"Jitter of {arcsec(section['jitter_rad'])} {fast}."
    if section["drift_rad"]:
        yield f"A drift of {arcsec(section['drift_rad'])} within {short(section['drift_time_scale_s'])} s."
    if section["positions_rad"]:
        yield f"Positions of detectors are wrong by {arcsec(section['positions_rad'])}."
    yield "All are the rms along an axis."


def _percent(share: float) -> str:
    return f"{_rounded(100 * share)} %"


def _rounded(value: float) -> str:
    return short(float(f"{value:.4g}"))


_SECTIONS: dict[str, Callable[[Values], Iterator[str]]] = {
    "responsivity_drift": _drift,
    "time_constants": _time_constants,
    "crosstalk": _crosstalk,
    "pointing_errors": _pointing_errors,
}
