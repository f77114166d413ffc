"""Tables of a sweep, from the content of its summary.json."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.results.metric_tables import heading, label
from surveysim.results.tables import rounded_column
from surveysim.runtime.numbers import number, percent, plural, quoted
from surveysim.runtime.table import SIGMA, Column, Table, column, file_column, quoted_columns, share_text
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.studies.sweep.axes import numbers_of, value_text
from surveysim.studies.sweep.comparison import SURE
from surveysim.studies.sweep.result import Pair
from surveysim.survey.discarded_scans import listed_data_sets

Content = Mapping[str, Any]  # content of summary.json
WITHHELD = "best_probability_withheld"


def sweep_table(summary: Content) -> Table:
    """Return a row for each point: values of the keys, sigma(A), the ratio to the reference point, discarded scans.

    Files have the columns `sigma_`, `error_`, `plain_sigma_` and `forecast_<data set>` [uK_CMB^2]; each metric of the
    actual data by its key, with `error_<metric>` and `forecast_<metric>`. The `ratio` to the reference point is of the
    metric that points are compared by, with its paired error; `best_probability` is NaN if withheld; the fraction
    `discarded` of scans is of the actual data, with a column for each data set that differs from it.

    Parameters
    ----------
    summary : mapping
        Content of the sweep's summary.json.
    """
    points = summary["points"]
    meta = {
        "temperature": "CMB",
        "metric": summary["metric"]["key"],
        "reference": summary["reference"],
        "best": summary["best"],
        "surveysim": summary["surveysim"],
        "seed": summary["seed"],
        "scenes_sha256": [point["scene_sha256"] for point in points],
    }
    columns = [
        file_column("point", [point["point"] for point in points]),
        *_settings(summary),
        column("n_det", [point["n_det"] for point in points], "detectors"),
        *_observations(summary),
        *_scores(summary),
        *_forecasts(summary),
        *_metrics(summary),
        *_discarded(summary),
        *_ratios(summary),
        file_column("unscored", [point.get("unscored", "") for point in points]),
    ]
    compared = summary["metric"]["key"]
    what = "uncertainty of a flat CMB band power" if compared == SIGMA_KEY else f"ratios are of {compared}"
    title = f"{summary['title']}: {what}"
    return Table("point", title, tuple(columns), tuple(summary["best"]), meta)


def data_set_table(summary: Content) -> Table | None:
    """Return sigma(A) of all data sets but the actual one at each point; None without others."""
    points = summary["points"]
    names = [name for name in _in_order(point["scores"] for point in points) if name != ACTUAL]
    if not names:
        return None
    columns = [item for item in _settings(summary) if item.cells is not None]
    for name in names:
        columns += _score_columns(points, name, name)
    return Table("other", f"Other data sets: {SIGMA}", tuple(columns))


def pair_table(pairs: Sequence[Pair], key: str = SIGMA_KEY) -> Table:
    """Return a row for each pair of points with a score: the metric of `point` over that of `other`, and its errors."""
    names = {"paired_error": "ratio_error"}
    columns = (file_column(names.get(name, name), [vars(pair)[name] for pair in pairs]) for name in vars(pairs[0]))
    return Table("pair", f"Ratios of {label(key)}", tuple(columns))


def varied_keys(summary: Content) -> list[str]:
    """List the keys that name a point: for each axis those whose values differ, or its first."""
    found: list[str] = []
    for axis in summary["axes"]:
        texts = [[value_text(value) for value in column] for column in zip(*axis["values"], strict=True)]
        differ = [key for key, column in zip(axis["keys"], texts, strict=True) if len(set(column)) > 1]
        found += differ or axis["keys"][:1]
    return found


def chance_text(probability: float) -> str:
    """Format a probability as ``93 %``, within the precision of the draws."""
    if probability > SURE:
        return f"> {100 * SURE:g} %"
    return f"{100 * probability:.0f} %" if probability > 1 - SURE else f"< {100 * (1 - SURE):.1g} %"


def _settings(summary: Content) -> Iterator[Column]:
    """Columns of the keys' values: numbers with their unit, or texts."""
    keys = varied_keys(summary)
    for key in summary["points"][0]["settings"]:
        values = [point["settings"][key] for point in summary["points"]]
        texts, found = [value_text(value) for value in values], numbers_of(values)
        numbers, unit = (texts, "") if found is None else found
        yield Column(key, numbers, unit, key, tuple(texts) if key in keys else None)


def _observations(summary: Content) -> Iterator[Column]:
    """Column of the numbers of simulated observations; files alone have equal ones."""
    if summary["kind"] == "simulated":
        values = [point["observations"] for point in summary["points"]]
        yield (
            column("observations", values, "observations")
            if "stopped" in summary
            else file_column("observations", values)
        )


def stop_sentence(summary: Content) -> str:
    """Return a sentence on the end of a sweep with a target error; empty for other sweeps."""
    if (stopped := summary.get("stopped")) is None:
        return ""
    rounds, done = stopped["rounds"], sum(point["observations"] for point in summary["points"])
    after = f"The sweep ended after {plural(len(rounds), 'round')}, to {rounds[-1]} observations, {done} in all"
    confidence, target = percent(stopped["confidence"]), percent(stopped["target_error"])
    reasons = {
        "confidence": f"the best point is known with a confidence of {confidence} at least",
        "target": f"the ratios of the points that may be the best are known to {target}",
        "all": "the points that may be the best have all their observations",
    }
    return f"{after}: {reasons[stopped['reason']]}."


def _scores(summary: Content) -> Iterator[Column]:
    """Columns of sigma(A) of each data set; the terminal shows the actual data."""
    points = summary["points"]
    names = _in_order(point["scores"] for point in points)
    if summary["kind"] == "simulated" and not names:
        yield column("score", ["not scored"] * len(points), SIGMA, in_files=False)
    for name in names:
        shown, error = _score_columns(points, name, SIGMA)
        yield shown if name == ACTUAL else file_column(shown.name, shown.values, shown.unit)
        yield error
        yield file_column(f"plain_sigma_{name}", _of_scores(points, name, "plain_sigma_ukcmb2"), "uK2")


def _score_columns(points: Sequence[Content], name: str, heading: str) -> tuple[Column, Column]:
    values, errors = (_of_scores(points, name, key) for key in ("sigma_ukcmb2", "error_ukcmb2"))
    names, absent = (f"sigma_{name}", f"error_{name}"), "not scored" if name == ACTUAL else ""
    return quoted_columns(names, values, errors, heading, unit="uK2", absent=absent)


def _metrics(summary: Content) -> Iterator[Column]:
    """Columns of all metrics of the actual data but sigma(A); people see the one that points are compared by."""
    points, compared = summary["points"], summary["metric"]["key"]
    for key in _in_order(point["metrics"] for point in points):
        if key == SIGMA_KEY:
            continue
        entries = [point["metrics"].get(key, {}) for point in points]
        unit = next(entry["unit"] for entry in entries if entry)
        of = {name: [entry.get(name) for entry in entries] for name in ("value", "error", "forecast")}
        if summary["kind"] == "simulated":
            names = key, f"error_{key}"
            shown, errors = quoted_columns(names, of["value"], of["error"], heading(key, unit), unit=unit)
            yield shown if key == compared else file_column(shown.name, shown.values, shown.unit)
            yield errors
        if any(value is not None for value in of["forecast"]):
            title = heading(key, unit) if summary["kind"] == "forecast" else "its forecast"
            shown = column(f"forecast_{key}", of["forecast"], title, number, unit=unit)
            yield shown if key == compared else file_column(shown.name, shown.values, shown.unit)


def _of_scores(points: Sequence[Content], name: str, key: str) -> list[float | None]:
    return [point["scores"].get(name, {}).get(key) for point in points]


def _forecasts(summary: Content) -> Iterator[Column]:
    """Columns of the forecasts of each data set; the terminal shows the actual data, with ! where it may be off."""
    points = summary["points"]
    heading = "forecast" if summary["kind"] == "simulated" else f"forecast {SIGMA}"
    errors, flags = _of_scores(points, ACTUAL, "error_ukcmb2"), [" !" * bool(p["forecast_flags"]) for p in points]
    for name in _in_order(point["forecast_ukcmb2"] for point in points):
        values = [point["forecast_ukcmb2"].get(name) for point in points]
        if name == ACTUAL:
            yield rounded_column(f"forecast_{name}", values, errors, heading, flags=flags)
        else:
            yield file_column(f"forecast_{name}", values, "uK2")


def _discarded(summary: Content) -> Iterator[Column]:
    """Columns of the fractions of discarded scans; none if unknown at all points."""
    shares = [point.get("discarded", {}) for point in summary["points"]]
    for name in listed_data_sets(shares):
        values = [item.get(name) for item in shares]
        if name == ACTUAL and summary["kind"] == "simulated":
            yield column("discarded", values, "discarded", share_text)
        else:
            yield file_column("discarded" if name == ACTUAL else f"discarded_{name}", values)


def _ratios(summary: Content) -> Iterator[Column]:
    """Columns of the ratio to the reference point and of the probability to be the best."""
    points, simulated = summary["points"], summary["kind"] == "simulated"
    ratios = [point.get("ratio") for point in points]
    cells = tuple(ratio_text(point, summary["reference"]) for point in points)
    yield Column("ratio", ratios, "", "ratio", cells)
    if simulated:
        yield file_column("ratio_error", [point.get("ratio_error") for point in points])
        yield file_column("independent_error", [point.get("independent_error") for point in points])
        chances = [point.get("best_probability") for point in points]
        cells = tuple("withheld" if WITHHELD in point else _chance(point) for point in points)
        yield Column("best_probability", chances, "", "best", cells)


def ratio_text(point: Content, reference: int | None) -> str:
    """Format the ratio of a point to the reference point, with its paired error if known."""
    if "ratio" not in point:
        return ""
    if point["point"] == reference:
        return "1"
    return quoted(point["ratio"], point["ratio_error"]) if "ratio_error" in point else number(point["ratio"])


def _chance(point: Content) -> str:
    chance = point.get("best_probability", math.nan)
    return "" if math.isnan(chance) else chance_text(chance)


def _in_order(of_points: Iterable[Mapping[str, Any]]) -> list[str]:
    """All data sets of all points, in order of first appearance."""
    return list(dict.fromkeys(name for names in of_points for name in names))
