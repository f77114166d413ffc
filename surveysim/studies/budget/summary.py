"""Content of summary.json of a budget."""

from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.strict_json import known
from surveysim.scene.scene import scene_hash
from surveysim.studies.budget.costs import Estimate, StageCost
from surveysim.studies.budget.points import WHOLE, Cost, as_options
from surveysim.studies.budget.result import BudgetResult
from surveysim.studies.sweep.point_store import PointResult


def budget_summary(result: BudgetResult) -> dict[str, Any]:
    """Return the content of a budget's summary.json."""
    budget = result.budget
    whole = budget.sweep.points[WHOLE].scene
    total = result.total
    return {
        "scene": budget.name,
        "title": whole.title,
        "seed": whole.seed,
        "scene_sha256": scene_hash(whole),
        **made_by(),
        "detectors": result.points[WHOLE].n_det,
        "kind": "simulated" if result.simulated else "forecast",
        "budget": {
            "metric": vars(result.comparison.quantity) | known({"exponent": result.exponent}),
            "floor": budget.stages.floor,
            "stages": [_stage_entry(result, item) for item in result.costs],
            "total": {name: _entry(getattr(total, name)) for name in ("least", "removed", "added", "together")}
            | {"missing": list(total.missing)},
            "pairs": [{"stages": list(item.names), **_entry(item.interaction)} for item in result.pairs],
            "points": [_point_entry(result, number) for number in range(len(result.points))],
        },
        "warnings": result.warnings,
        "run": {
            "date": now(),
            "engine": result.engine,
            "workers": result.workers,
            "wall_s": result.wall_s,
            "point_s": [item.wall_s for item in result.points],
        },
    }


def _entry(found: Estimate) -> dict[str, float | None]:
    return known({"value": found.value, "error": found.error})


def _stage_entry(result: BudgetResult, item: StageCost) -> dict[str, Any]:
    row, stages = item.row, result.budget.stages
    entry = {
        "name": row.name,
        "title": row.title,
        "needs": sorted(stages.required(row.name)),
        "needed_by": sorted(stages.dependent(row.name)),
        "options": as_options(stages.removal(stages.dependent(row.name) | {row.name})),
        "removed": _cost_entry(result, row.removed, item.removed_ratio, item.removed_time),
        "interaction": _entry(item.interaction),
        "small": item.small,
    }
    if row.added is not None:
        entry["added"] = _cost_entry(result, row.added, item.added_ratio, item.added_time)
    if reason := row.reason or _unscored(result, row.removed, row.added):
        entry["reason"] = reason
    return entry


def _cost_entry(result: BudgetResult, cost: Cost, ratio: Estimate, time: Estimate) -> dict[str, Any]:
    entry = {"with": cost.present, "without": cost.absent, "ratio": _entry(ratio), "time": _entry(time)}
    numbers = [number for number in (cost.present, cost.absent) if number is not None]
    return entry | {"comparable": not result.simulated or result.comparable(numbers)}


def _unscored(result: BudgetResult, *costs: Cost | None) -> str:
    """Reasons why points of some costs have no score."""
    numbers = [number for cost in costs if cost for number in (cost.present, cost.absent) if number is not None]
    return "; ".join(filter(None, dict.fromkeys(result.points[number].unscored for number in numbers)))


def _point_entry(result: BudgetResult, number: int) -> dict[str, Any]:
    point, item, comparison = result.budget.sweep.points[number], result.points[number], result.comparison
    given = result.budget.sweep.origin.overrides
    entry: dict[str, Any] = {
        "point": number,
        "label": point.label,
        "without": [name for name in result.budget.stages.stages if name in result.budget.removed[number]],
        "options": as_options(given | point.settings),
    }
    error = float(comparison.error[number]) if result.simulated else None
    entry |= known({"value": float(comparison.value[number]), "error": error, "forecast": _forecast(result, item)})
    entry["forecast_flags"] = item.flags
    if item.discarded:
        entry["discarded"] = item.discarded.get(ACTUAL)
    return entry


def _forecast(result: BudgetResult, item: PointResult) -> float | None:
    """Forecast of the metric at a point; None without one."""
    key = result.budget.sweep.metric
    if result.simulated:
        return item.metrics[ACTUAL][key].forecast if item.metrics else None
    return item.metric_forecasts[ACTUAL][key].value if item.metric_forecasts else None
