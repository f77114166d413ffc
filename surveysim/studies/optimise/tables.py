"""Tables of an optimisation: its knobs, its designs, the front, and all evaluations."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from surveysim.runtime.numbers import count, number, with_error
from surveysim.runtime.table import Column, Table, column, file_column, share_text
from surveysim.studies.optimise.result import OptimiseResult
from surveysim.studies.sweep.axes import numbers_of, value_text
from surveysim.studies.sweep.tables import sweep_table

Content = Mapping[str, Any]  # content of summary.json
ENDS = {"1 %": "", "range": " (end of the search)", "limit": " (limit)"}


def optimum_table(summary: Content) -> Table:
    """Return a row for each knob: its values in the scene as it is and in the best design, and within 1 % of it."""
    knobs = summary["optimum"]["knobs"]
    columns = [
        column("key", [item["key"] for item in knobs], "knob"),
        column("searched", [_searched(item) for item in knobs], "searched"),
        column("as_it_is", [value_shown(item.get("as_it_is", "")) for item in knobs], "as it is"),
        column("best", [value_shown(item["best"]) for item in knobs], "best"),
    ]
    if "within_1_percent" in knobs[0]:
        ranges = [item["within_1_percent"] for item in knobs]
        columns.append(column("within_1_percent", list(map(_within, ranges)), "within 1 % of the best"))
    if "importance" in knobs[0]:
        columns += _importance([item["importance"] for item in knobs])
    meta = {"surveysim": summary["surveysim"], "seed": summary["seed"], "scene_sha256": summary["scene_sha256"]}
    return Table("knob", f"{summary['title']}: best design by forecast", tuple(columns), (), meta)


def _importance(found: Sequence[Content]) -> Iterator[Column]:
    for name, heading in (("first", "alone"), ("total", "with interactions")):
        values, errors = [item.get(name) for item in found], [item.get(f"{name}_error") for item in found]
        cells = tuple("" if a is None else with_error(a, b) for a, b in zip(values, errors, strict=True))
        yield Column(f"sobol_{name}", values, "", f"share of the variance, {heading}", cells)
        yield file_column(f"sobol_{name}_error", errors)


def _searched(knob: Content) -> str:
    if "choices" in knob:
        return ", ".join(map(value_text, knob["choices"]))
    return f"{value_shown(knob['low'])} to {value_shown(knob['high'])}"


def _within(item: Content) -> str:
    if "choices" in item:
        return ", ".join(map(value_text, item["choices"]))
    low, high = (f"{value_shown(item[end])}{ENDS[item[f'{end}_end']]}" for end in ("low", "high"))
    return high if item["low"] == item["high"] else f"{low} to {high}"


def metric_text(value: float) -> str:
    """Format a metric to three digits; whole numbers, such as of detectors, as they are."""
    return count(value) if value % 1 == 0 else number(value)


def value_shown(value: Any) -> str:
    """Format a value of the file, numbers rounded to three digits."""
    text = value_text(value)
    first, space, unit = text.partition(" ")
    try:
        found = float(first)
    except ValueError:
        return text
    return f"{found:.3g}{space}{unit}" if abs(found) < 1000 else f"{found:.0f}{space}{unit}"


def design_table(summary: Content) -> Table:
    """Return a row for each design that was, or would be, simulated: forecast metrics and settings."""
    designs = summary["optimum"]["designs"]
    return _designs("design", "Designs, by forecast", [item["name"] for item in designs], designs, summary)


def front_table(summary: Content) -> Table | None:
    """Return a row for each design of the Pareto front; None with one metric."""
    designs = summary["optimum"]["front"]
    if not designs:
        return None
    return _designs("front", "Pareto front, by forecast", list(range(len(designs))), designs, summary)


def _designs(name: str, title: str, names: Sequence[Any], designs: Sequence[Content], summary: Content) -> Table:
    found, best = summary["optimum"], summary["optimum"]["best"]["settings"]
    columns = [column("design", names, "design")]
    for metric in found["metrics"]:
        values = [item["metrics"].get(metric["key"]) for item in designs]
        heading = f"{metric['key']} [{metric['unit']}]" if metric["unit"] else metric["key"]
        columns.append(column(metric["key"], values, heading, metric_text, unit=metric["unit"]))
    if any("smoothed" in item for item in designs):
        values = [item.get("smoothed") for item in designs]
        columns.append(column("smoothed", values, "smoothed", number, unit=found["metrics"][0]["unit"]))
    if any("discarded" in item for item in designs):
        columns.append(column("discarded", [item.get("discarded") for item in designs], "discarded", share_text))
    columns += _settings([item["settings"] for item in designs], list(best), {item["key"] for item in found["knobs"]})
    rows = tuple(row for row, item in enumerate(designs) if item["settings"] == best)
    return Table(name, title, tuple(columns), rows, {"scene_sha256": summary["scene_sha256"]})


def _settings(settings: Sequence[Content], keys: Sequence[str], knobs: Collection[str]) -> Iterator[Column]:
    """Columns of the values of keys, as texts, for people those of knobs alone; empty for the scene as it is."""
    for key in keys:
        values = [value_text(item[key]) if key in item else "" for item in settings]
        yield column(key, values, key, value_shown) if key in knobs else file_column(key, values)


def evaluation_table(result: OptimiseResult) -> Table:
    """Return a row for each design that was forecast, in order; the first is the scene as it is.

    Numbers of knobs are in the unit of their range. Metrics are NaN for a design without a forecast, for the reason
    that stands in `refused`.
    """
    problem, items = result.problem, result.found.evaluations
    columns = [column("evaluation", list(range(len(items))), "evaluation")]
    for knob in problem.knobs:
        values = [item.settings.get(knob.key) for item in items]
        found = numbers_of([value for value in values if value is not None])
        if knob.choices or found is None:
            columns.append(file_column(knob.key, ["" if value is None else value_text(value) for value in values]))
        else:
            numbers = iter(found[0])
            columns.append(
                file_column(knob.key, [None if v is None else float(next(numbers)) for v in values], knob.unit)
            )
    for metric in sorted({key: None for item in items for key in item.metrics}):
        columns.append(file_column(metric, [item.metrics.get(metric) for item in items], result.unit(metric)))
    columns += [
        file_column("allowed", np.array([item.allowed for item in items])),
        file_column("discarded", [item.discarded for item in items]),
        file_column("refused", [item.reason for item in items]),
    ]
    meta = {"scene_sha256": problem.identity, "seed": problem.scene.seed}
    return Table("evaluation", "Designs that were forecast", tuple(columns), (), meta)


def simulated_table(summary: Content) -> Table:
    """Return a row for each simulated design, as `sweep_table`; people read the values of the knobs alone."""
    table, found = sweep_table(summary["simulated"]), summary["optimum"]
    derived = found["best"]["settings"].keys() - {item["key"] for item in found["knobs"]}
    columns = [replace(item, cells=None) if item.name in derived else item for item in table.columns]
    return replace(table, title="The best design and its rivals, simulated", columns=tuple(columns))
