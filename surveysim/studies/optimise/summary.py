"""Content of summary.json of an optimisation."""

import math
import re
from collections.abc import Iterable
from typing import Any

from surveysim.reduction.setup import prepare
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.strict_json import known
from surveysim.scene.scene import scene_hash
from surveysim.studies.optimise.expressions import key_value
from surveysim.studies.optimise.knobs import Knob
from surveysim.studies.optimise.ranges import TOLERANCE, KnobRange
from surveysim.studies.optimise.result import OptimiseResult
from surveysim.studies.sweep.result import pairs
from surveysim.studies.sweep.summary import sweep_summary

_NUMBERS = re.compile(r"\d+(\.\d+)?(e[+-]?\d+)?")


def grouped(reasons: Iterable[str]) -> dict[str, int]:
    """Count reasons that differ in numbers alone as the first of them, the most frequent ones first."""
    groups: dict[str, list[str]] = {}
    for reason in reasons:
        groups.setdefault(_NUMBERS.sub("", reason), []).append(reason)
    return {group[0]: len(group) for group in sorted(groups.values(), key=len, reverse=True)}


def optimum_summary(result: OptimiseResult) -> dict[str, Any]:
    """Return the content of an optimisation's summary.json."""
    problem, found = result.problem, result.found
    scene, options = problem.scene, problem.options
    refused = grouped(item.reason or "beyond a limit" for item in found.evaluations if not item.allowed)
    content: dict[str, Any] = {
        "scene": scene.name,
        "title": scene.title,
        "seed": scene.seed,
        "scene_sha256": scene_hash(scene),
        **made_by(),
        "optimum": {
            "metrics": [{"key": key, "unit": result.unit(key)} for key in options.metrics],
            "detectors": prepare(scene).camera.n_det,
            "evaluations": len(found.evaluations),
            "refused": refused,
            "spent": found.spent,
            "limits": [item.model_dump(exclude_none=True) for item in options.limits],
            "knobs": [_knob_entry(result, number) for number in range(len(problem.knobs))],
            "best": _design_entry(result, found.best),
            "designs": [{"name": item.name} | _design_entry(result, item.number) for item in found.designs],
            "front": [_design_entry(result, number) for number in found.front],
        },
        "warnings": result.warnings,
        "run": {"date": now(), "engine": result.engine, "workers": result.workers, "wall_s": result.wall_s},
    }
    if math.isfinite(found.scatter):
        content["optimum"]["scatter"] = found.scatter
    if result.simulated is not None:
        content["simulated"] = sweep_summary(result.simulated, pairs(result.simulated))
    return content


def _design_entry(result: OptimiseResult, number: int) -> dict[str, Any]:
    item, smoothed = result.found.evaluations[number], result.found.smoothed.get(number)
    entry: dict[str, Any] = {"settings": item.settings, "metrics": item.metrics, "flags": list(item.flags)}
    entry |= {} if smoothed is None else {"smoothed": smoothed}
    return entry | known({"discarded": item.discarded})


def _knob_entry(result: OptimiseResult, number: int) -> dict[str, Any]:
    """Range, best value, values within 1 % and importance of one knob."""
    problem, found = result.problem, result.found
    knob = problem.knobs[number]
    entry: dict[str, Any] = {"key": knob.key, "unit": knob.unit, "scale": "log" if knob.log else "linear"}
    if knob.choices:
        entry["choices"] = [knob.value(place) for place in knob.steps()]
    else:
        entry |= {"low": knob.value(0.0), "high": knob.value(1.0)}
    present = key_value(problem.content, knob.key)
    entry["best"] = found.evaluations[found.best].settings[knob.key]
    if present is not None:
        entry["as_it_is"] = present
    if found.ranges:
        entry["within_1_percent"] = _within(knob, found.ranges[number])
    if found.importance:
        names = ("first", "first_error", "total", "total_error")
        entry["importance"] = known({name: float(getattr(found.importance, name)[number]) for name in names})
    return entry


def _within(knob: Knob, item: KnobRange) -> dict[str, Any]:
    """Ends of the range within 1 %, or the choices."""
    if knob.choices:
        top = item.values[item.places == item.low][0] + math.log1p(TOLERANCE)
        inside = item.places[item.values <= top]
        return {"choices": [knob.value(place) for place in inside]}
    return {
        "low": knob.value(item.low),
        "high": knob.value(item.high),
        "low_end": item.ends[0],
        "high_end": item.ends[1],
    }
