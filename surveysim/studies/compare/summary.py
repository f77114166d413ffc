"""Content of summary.json of a comparison."""

from typing import Any

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.runtime.strict_json import known
from surveysim.studies.compare.comparison import RunComparison
from surveysim.studies.compare.finished_run import OBSERVATIONS, FinishedRun
from surveysim.studies.sweep.comparison import Comparison
from surveysim.survey.discarded_scans import sweep_warnings

_ARCMIN = np.degrees(1) * 60
_WEATHER = {"b2_mk2": ("median_b2_mk2", 1.0), "pwv_mm": ("median_pwv_mm", 1.0)}
_WEATHER |= {"wind_speed_rad_s": ("median_wind_arcmin_s", _ARCMIN)}


def comparison_summary(result: RunComparison) -> dict[str, Any]:
    """Return the part of a comparison's summary.json that depends on the runs."""
    runs = [_run_entry(result, number) for number in range(len(result.runs))]
    entries = [_quantity_entry(name, item) for (name, _), item in result.quantities.items()]
    told = [{"key": key, "values": values} for key, values in result.differences.items()]
    compared = {"runs": runs, "differences": told, "quantities": entries}
    return {"compared": compared, "warnings": _warnings(result)}


def _run_entry(result: RunComparison, number: int) -> dict[str, Any]:
    run = result.runs[number]
    summary, stopped = run.summary, run.summary.get("stopped") or {}
    entry = {
        "label": run.label,
        "directory": str(run.directory),
        "scene": summary["scene"],
        "title": summary["title"],
        "seed": summary["seed"],
        "surveysim": summary["surveysim"],
        "scene_sha256": summary["scene_sha256"],
        "detectors": summary["detectors"],
        "observations": summary["observations"],
        "observations_of_survey": stopped.get("observations_of_survey", summary["observations"]),
        "discarded": run.discarded.get(ACTUAL),
        "errors": "paired" if result.paired(number) else "independent",
        **known(_weather(run)),
    }
    if reason := result.unpaired(number):
        entry["independent_because"] = reason
    return entry


def _weather(run: FinishedRun) -> dict[str, float]:
    """Medians over the observations, without quantities that the run does not have."""
    columns = run.table(OBSERVATIONS)
    medians = {
        told: float(np.median(columns[name])) * factor for name, (told, factor) in _WEATHER.items() if name in columns
    }
    return {name: value for name, value in medians.items() if np.isfinite(value)}


def _quantity_entry(name: str, item: Comparison) -> dict[str, Any]:
    arrays = {
        "values": item.value,
        "errors": item.error,
        "ratios": item.ratio,
        "ratio_errors": item.paired_error,
        "independent_errors": item.independent_error,
        "best_probability": item.best_probability,
    }
    lists = {key: [float(x) if np.isfinite(x) else None for x in values] for key, values in arrays.items()}
    quantity = item.quantity
    told = {"key": quantity.key, "unit": quantity.unit, "lower_is_better": quantity.lower_is_better}
    return {"data_set": name, **told, **lists}


def _warnings(result: RunComparison) -> list[str]:
    labels = [run.label for run in result.runs]
    found = sweep_warnings(labels, [run.discarded for run in result.runs], "runs")
    if result.plain:
        found.append(
            "a run has no forecast: runs that share random numbers are all quoted by plain estimates, for the weather"
            " drawn"
        )
    return found
