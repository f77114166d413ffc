"""Tables of metrics, from the content of summary.json."""

from collections.abc import Mapping, Sequence
from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.runtime.numbers import as_known, number, quoted
from surveysim.runtime.table import Column, Table, column, file_column
from surveysim.scene.metrics import SIGMA_KEY

Content = Mapping[str, Any]  # content of summary.json
_UNITS = {"uK2": "uK_CMB^2", "mK s(1/2)": "mK sqrt(s)", "mK": "mK_CMB"}
_TITLE = "Further scores of the same maps"


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
        columns.append(column(name, entries, name, metric_text))
        if name == ACTUAL and any(entry.get("forecast") is not None for entry in actual):
            columns.append(column("forecast", actual, "forecast", _forecast_text))
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
        cells = [number(found[key].value) if not found[key].note else found[key].note for key in keys]
        columns.append(column(name, cells, name))
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
    if entry.get("note"):
        return entry["note"]
    return quoted(value, entry["error"])


def _forecast_text(entry: Content) -> str:
    value = entry.get("forecast")
    return "" if value is None or entry.get("note") else as_known(value, entry["error"])


def _units(units: Sequence[str]) -> Column:
    return column("unit", units, "unit", lambda unit: _UNITS.get(unit, unit))
