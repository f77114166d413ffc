"""A finished sweep as tables and as the content of its summary.json."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from surveysim import __version__
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import prepare
from surveysim.results.results import known
from surveysim.results.stages import left_out
from surveysim.results.table import Table
from surveysim.runtime.provenance import made_by, now
from surveysim.scene.scene import scene_hash
from surveysim.studies.sweep.axes import numbers_of, value_text
from surveysim.studies.sweep.comparison import Pair, SweepResult
from surveysim.survey.discarded_scans import telling

MATRIX_POINTS = 12  # as many columns fit on a page


def sweep_table(result: SweepResult) -> Table:
    """A row for each point: values of the keys, sigma(A) of each data set, and the actual one against the others.

    `sigma_`, `error_`, `plain_sigma_` and `forecast_<data set>` are in uK_CMB^2; `ratio` is sigma(A) over that of the
    reference point with its paired error; `best_probability` that of being the lowest, NaN where it is withheld.
    `discarded` is the share of discarded scans of the actual data, with a column for each data set that differs from
    it. Forecasts have no errors.
    """
    sweep, comparison = result.sweep, result.comparison
    scenes = [point.scene for point in sweep.points]
    meta = {
        "temperature": "CMB",
        "reference": comparison.reference,
        "best": list(comparison.best),
        "surveysim": __version__,
        "seed": scenes[0].seed,
        "scenes_sha256": [scene_hash(scene) for scene in scenes],
    }
    table = Table({"point": np.arange(len(sweep.points))}, meta=meta)
    columns = table.columns
    for key in sweep.points[0].settings:
        _add_values(table, key, [point.settings[key] for point in sweep.points])
    columns["n_det"] = [point.n_det for point in result.points]
    for name in _in_order(item.scores for item in result.points):
        bands = [item.scores[name].band if name in item.scores else None for item in result.points]
        columns[f"sigma_{name}"] = [np.nan if band is None else band.sigma_ukcmb2 for band in bands]
        columns[f"error_{name}"] = [np.nan if band is None else band.error_ukcmb2 for band in bands]
        plain = [item.scores[name].plain_band if name in item.scores else None for item in result.points]
        columns[f"plain_sigma_{name}"] = [np.nan if band is None else band.sigma_ukcmb2 for band in plain]
    for name in _in_order(item.forecast_ukcmb2 for item in result.points):
        columns[f"forecast_{name}"] = [item.forecast_ukcmb2.get(name, np.nan) for item in result.points]
    table.units.update(
        {name: "uK2" for name in columns if name.startswith(("sigma_", "error_", "plain_", "forecast_"))}
    )
    _add_discarded(table, result)
    columns["ratio"] = comparison.ratio
    if result.simulated:
        columns["ratio_error"] = comparison.paired_error
        columns["independent_error"] = comparison.independent_error
        columns["best_probability"] = comparison.best_probability
    columns["unscored"] = [item.unscored for item in result.points]
    return table


def _add_discarded(table: Table, result: SweepResult) -> None:
    """Columns of the shares of discarded scans, none where no point knows its own."""
    shares = [item.discarded for item in result.points]
    for name in telling(shares):
        column = "discarded" if name == ACTUAL else f"discarded_{name}"
        table.columns[column] = [item.get(name, np.nan) for item in shares]


def pair_table(pairs: Sequence[Pair]) -> Table:
    """A row for each pair of points with a score: sigma(A) of `point` over that of `other`, and its errors."""
    names = {"paired_error": "ratio_error"}
    return Table({names.get(name, name): [vars(pair)[name] for pair in pairs] for name in vars(pairs[0])})


def _add_values(table: Table, key: str, values: list[Any]) -> None:
    """A column of a key's values: numbers with their unit, or else text."""
    found = numbers_of(values)
    table.columns[key] = [value_text(value) for value in values] if found is None else found[0]
    if found is not None and found[1]:
        table.units[key] = found[1]


def _in_order(of_points: Iterable[dict[str, Any]]) -> list[str]:
    """All data sets of all points, in the order in which they first come."""
    return list(dict.fromkeys(name for names in of_points for name in names))


def sweep_summary(result: SweepResult, pairs: Sequence[Pair]) -> dict[str, Any]:
    """The content of a sweep's summary.json; the `pairs` of a few points are told there too."""
    sweep, comparison = result.sweep, result.comparison
    scene = sweep.points[0].scene
    points = [_point_entry(result, number) for number in range(len(sweep.points))]
    return {
        "scene": sweep.name,
        "title": scene.title,
        "seed": scene.seed,
        **made_by(),
        "axes": [{"name": axis.name, "keys": list(axis.keys), "values": axis.values} for axis in sweep.axes],
        "kind": "simulated" if result.simulated else "forecast",
        "estimate": result.estimate,
        "left_out": left_out(prepare(scene)),
        "reference": comparison.reference,
        "best": list(comparison.best),
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
    }
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
