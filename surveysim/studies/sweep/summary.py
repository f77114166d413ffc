"""Content of summary.json of a sweep."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.strict_json import known
from surveysim.scene.scene import scene_hash
from surveysim.studies.sweep.point_store import PointResult
from surveysim.studies.sweep.result import Pair, SweepResult
from surveysim.studies.sweep.rounds import Rounds

MATRIX_POINTS = 12  # most columns that fit on a page


def sweep_summary(result: SweepResult, pairs: Sequence[Pair]) -> dict[str, Any]:
    """Return the content of a sweep's summary.json, with the `pairs` of a few points."""
    sweep, comparison = result.sweep, result.comparison
    scene = sweep.points[0].scene
    points = [_point_entry(result, number) for number in range(len(sweep.points))]
    stopped = {} if result.rounds is None else {"stopped": _stopped(result.rounds)}
    return {
        "scene": sweep.name,
        "title": scene.title,
        "seed": scene.seed,
        **made_by(),
        "axes": [{"name": axis.name, "keys": list(axis.keys), "values": axis.values} for axis in sweep.axes],
        "kind": "simulated" if result.simulated else "forecast",
        "estimate": result.estimate,
        "metric": vars(comparison.quantity),
        "reference": comparison.reference,
        "best": list(comparison.best),
        **stopped,
        "points": points,
        "pairs": [known(vars(pair)) for pair in pairs] if len(points) <= MATRIX_POINTS else [],
        "warnings": result.warnings,
        "run": {
            "date": now(),
            "engine": result.engine,
            "workers": result.workers,
            "wall_s": result.wall_s,
            "point_s": [item.wall_s for item in result.points],
        },
    }


def _stopped(rounds: Rounds) -> dict[str, Any]:
    return {"reason": rounds.reason, **vars(rounds.limits), "rounds": list(rounds.ends)}


def _point_entry(result: SweepResult, number: int) -> dict[str, Any]:
    point, item, comparison = result.sweep.points[number], result.points[number], result.comparison
    entry = {
        "point": number,
        "label": point.label,
        "settings": point.settings,
        "scene_sha256": scene_hash(point.scene),
        "n_det": item.n_det,
        "scores": {
            name: known(
                {
                    "sigma_ukcmb2": score.band.sigma_ukcmb2,
                    "error_ukcmb2": score.band.error_ukcmb2,
                    "plain_sigma_ukcmb2": score.plain_band.sigma_ukcmb2,
                }
            )
            for name, score in item.scores.items()
        },
        "forecast_ukcmb2": item.forecast_ukcmb2,
        "forecast_flags": item.flags,
        "metrics": _metric_entries(item),
    }
    if result.simulated:
        entry["observations"] = item.observations
    if item.off:
        entry["forecast_over_simulated"] = known(dict(zip(("sigma", "sigma_error"), item.off, strict=True)))
    if item.discarded:
        entry |= {"discarded": item.discarded, "discarded_by_weather": item.discarded_by_weather}
    if item.unscored:
        entry["unscored"] = item.unscored
    if np.isfinite(comparison.ratio[number]):
        entry["ratio"] = float(comparison.ratio[number])
        if result.simulated:
            errors = {"ratio_error": comparison.paired_error, "independent_error": comparison.independent_error}
            entry |= known({name: float(values[number]) for name, values in errors.items()})
            if reason := result.withheld(number):
                entry["best_probability_withheld"] = reason
            else:
                entry["best_probability"] = float(comparison.best_probability[number])
    return entry


def _metric_entries(item: PointResult) -> dict[str, dict[str, Any]]:
    """Metrics of the actual data by key: value with error of a run, and forecast."""
    entries = {}
    for key, found in item.metrics.get(ACTUAL, {}).items():
        entries[key] = {"value": found.value, "error": found.error, "unit": found.unit}
        entries[key] |= {} if found.forecast is None else {"forecast": found.forecast}
    for key, quantity in item.metric_forecasts.get(ACTUAL, {}).items():
        entries[key] = {"forecast": quantity.value, "unit": quantity.unit}
    return {key: known(entry) for key, entry in entries.items()}
