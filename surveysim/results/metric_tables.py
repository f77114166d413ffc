"""Tables of metrics, from the content of summary.json."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.runtime.numbers import as_known, number, quoted
from surveysim.runtime.table import Column, Table, column, file_column
from surveysim.scene.metrics import SIGMA_KEY

Content = Mapping[str, Any]  # content of summary.json
_UNITS = {"uK2": "uK_CMB^2", "mK s(1/2)": "mK sqrt(s)"}
_TITLE = "Metrics of the same maps"


def metric_entries(metrics: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return metrics by data set and key, as summary.json has them: NaN and infinity become null there."""
    return {name: {key: _entry(item) for key, item in found.items()} for name, found in metrics.items()}


def _entry(item: Any) -> dict[str, Any]:
    entry = {
        "value": item.quoted.value,
        "error": item.quoted.error,
        "plain_value": item.plain.value,
        "plain_error": item.plain.error,
        "unit": item.unit,
        "lower_is_better": item.lower_is_better,
    }
    entry |= {} if item.forecast is None else {"forecast": item.forecast}
    return entry | ({"note": item.note} if item.note else {})


def metric_file_table(metrics: Content, meta: Content) -> Table:
    """Return a row for each data set and quantity, as tables/metrics.ecsv has it, from the entry `metrics`."""
    rows = [(name, key, entry) for name, found in metrics.items() for key, entry in found.items()]
    columns = [file_column("name", [name for name, _, _ in rows]), file_column("metric", [key for _, key, _ in rows])]
    for key in ("value", "error", "plain_value", "plain_error", "forecast"):
        columns.append(file_column(key, [entry.get(key) for _, _, entry in rows]))
    columns.append(file_column("unit", [entry["unit"] for _, _, entry in rows]))
    columns.append(file_column("lower_is_better", [entry["lower_is_better"] for _, _, entry in rows]))
    columns.append(file_column("note", [entry.get("note", "") for _, _, entry in rows]))
    return Table("metrics", _TITLE, tuple(columns), meta=meta)


def metric_table(metrics: Content) -> Table | None:
    """Return a row for each quantity and a column for each data set, from the entry `metrics`.

    sigma(A) is in the score table. None without another quantity.
    """
    keys = [key for key in metrics[ACTUAL] if key != SIGMA_KEY] if metrics else []
    if not keys:
        return None
    actual = [metrics[ACTUAL][key] for key in keys]
    columns = [column("metric", keys, "metric"), _units([entry["unit"] for entry in actual])]
    for name, found in metrics.items():
        entries = [found[key] for key in keys]
        columns.append(_numbers(name, [entry["value"] for entry in entries], map(metric_text, entries)))
        if name == ACTUAL and any(entry.get("forecast") is not None for entry in actual):
            forecasts = [entry.get("forecast") for entry in actual]
            columns.append(_numbers("forecast", forecasts, map(_forecast_text, actual)))
    return Table("metric", _TITLE, tuple(columns))


def metric_forecast_table(metrics: Mapping[str, Mapping[str, Any]]) -> Table | None:
    """Return a row for each quantity and a column for each data set, of forecasts; None without any but sigma(A).

    Parameters
    ----------
    metrics
        Forecasts (`surveysim.results.metrics.MetricForecast`) by data set and key.
    """
    first = next(iter(metrics.values()), {})
    keys = [key for key in first if key != SIGMA_KEY]
    if not keys:
        return None
    columns = [column("metric", keys, "metric"), _units([first[key].unit for key in keys])]
    for name, found in metrics.items():
        items = [found[key] for key in keys]
        cells = (number(item.value) if np.isfinite(item.value) else item.note for item in items)
        columns.append(_numbers(name, [item.value for item in items], cells))
    return Table("metric", _TITLE, tuple(columns))


def label(key: str) -> str:
    """Name of a quantity for people."""
    return "sigma(A)" if key == SIGMA_KEY else key


def with_unit(text: str, unit: str) -> str:
    """Append a unit, as people read it, to a text."""
    return f"{text} {_UNITS.get(unit, unit)}".rstrip()


def heading(key: str, unit: str) -> str:
    """Heading of a column of a quantity."""
    shown = _UNITS.get(unit, unit)
    return f"{label(key)} [{shown}]" if shown else label(key)


def metric_text(entry: Content) -> str:
    """Format a value with its error, or the reason for none."""
    value = entry["value"]
    if value is None or not np.isfinite(value):
        return entry.get("note", "unknown")
    return quoted(value, entry["error"])


def metric_notes(metrics: Content) -> list[str]:
    """Return a line for each note on values that there are, from the entry `metrics`."""
    return _notes((key, entry["value"], entry.get("note", "")) for key, entry in metrics[ACTUAL].items())


def metric_forecast_notes(metrics: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return a line for each note on values that there are, from forecasts as for `metric_forecast_table`."""
    first = next(iter(metrics.values()), {})
    return _notes((key, item.value, item.note) for key, item in first.items())


def _notes(items: Iterable[tuple[str, float | None, str]]) -> list[str]:
    keys: dict[str, list[str]] = {}
    for key, value, note in items:
        if note and value is not None and np.isfinite(value):
            keys.setdefault(note, []).append(key)
    return [f"{', '.join(names)}: {note}." for note, names in keys.items()]


def _forecast_text(entry: Content) -> str:
    value = entry.get("forecast")
    if value is None or not np.isfinite(value):
        return ""
    return as_known(value, entry["error"]) if 1e-3 <= abs(value) < 1e6 else number(value)


def _numbers(name: str, values: Sequence[float | None], cells: Iterable[str]) -> Column:
    return Column(name, values, "", name, tuple(cells))


def _units(units: Sequence[str]) -> Column:
    return column("unit", units, "unit", lambda unit: _UNITS.get(unit, unit))
