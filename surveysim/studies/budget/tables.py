"""Tables of a budget, from the content of its summary.json."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from surveysim.results.metric_tables import heading, label
from surveysim.runtime.numbers import MINUS, as_known, number, quoted, quoted_share
from surveysim.runtime.table import Column, Table, column, file_column, quoted_columns, share_text

Content = Mapping[str, Any]  # content of summary.json, or an entry of it
TITLE = "Cost of each stage"
PARTS = {"removed": "removed alone", "added": "added alone"}
EXACT = 1e-5  # relative error below which only rounding is left
NOT_COMPARABLE = " *"  # after a cost of points that lose different fractions of their scans


def budget_table(summary: Content) -> Table:
    """Return a row for each stage: ratios of the metric, survey time, interaction, and the options that remove it.

    Files have the columns `removed_ratio`, `removed_time`, `added_ratio`, `added_time` and `interaction`, each with its
    `_error`; the numbers of the points of each, as budget_points.ecsv has them; and the `reason` for a missing cost.
    Times are shares of the survey time of the whole scene.
    """
    stages = summary["budget"]["stages"]
    columns = [
        file_column("stage", [item["name"] for item in stages]),
        column("title", [item["title"] for item in stages], "stage"),
    ]
    for part, place in PARTS.items():
        columns += _cost_columns(part, place, [item.get(part) for item in stages])
    columns += _estimates("interaction", "interaction", [item["interaction"] for item in stages], [""] * len(stages))
    columns += [
        file_column("options", [item["options"] for item in stages]),
        file_column("reason", [item.get("reason", "") for item in stages]),
    ]
    title = f"{summary['title']}: {TITLE[0].lower()}{TITLE[1:]}, by {label(summary['budget']['metric']['key'])}"
    return Table("budget", title, tuple(columns), meta=_meta(summary))


def point_table(summary: Content) -> Table:
    """Return a row for each point: its stages, the metric, discarded scans, and the options of the command ``run``."""
    points, metric = summary["budget"]["points"], summary["budget"]["metric"]
    value, error, expected = ([item[key] for item in points] for key in ("value", "error", "forecast"))
    name, unit = heading(metric["key"], metric["unit"]), metric["unit"]
    columns = [
        column("point", [item["point"] for item in points], "point"),
        column("label", [item["label"] for item in points], "stages"),
    ]
    if summary["kind"] == "simulated":
        columns += quoted_columns(("value", "error"), value, error, name, unit=unit, absent="not scored")
        cells = tuple("" if seen is None else as_known(seen, of) for seen, of in zip(expected, error, strict=True))
        columns.append(Column("forecast", expected, unit, "forecast", cells))
        columns.append(column("discarded", [item.get("discarded") for item in points], "discarded", share_text))
    else:
        columns.append(column("value", value, f"forecast {name}", number, unit=unit))
    columns.append(column("options", [item["options"] for item in points], "options"))
    return Table("point", "Points", tuple(columns), meta=_meta(summary))


def pair_table(summary: Content) -> Table:
    """Return a row for each pair of stages with its interaction, the largest first."""
    pairs = summary["budget"]["pairs"]
    titles = {item["name"]: item["title"] for item in summary["budget"]["stages"]}
    columns = [
        *(file_column(name, [item["stages"][k] for item in pairs]) for k, name in enumerate(("stage", "other"))),
        column("pair", [" and ".join(titles[name] for name in item["stages"]) for item in pairs], "pair"),
        *_estimates("interaction", "interaction", pairs, [""] * len(pairs)),
    ]
    return Table("pair", "Interactions of pairs, in survey time", tuple(columns), meta=_meta(summary))


def option_table(summary: Content) -> Table:
    """Return a row for each stage with the options of a command that remove it, and the stages that need it."""
    stages = summary["budget"]["stages"]
    columns = (
        column("title", [item["title"] for item in stages], "stage"),
        column("options", [item["options"] for item in stages], "options that remove it, and what needs it"),
    )
    return Table("option", "Scenes without a stage", columns)


def time_text(entry: Content) -> str:
    """Format a share of the survey time, with its error if it has one; empty without a value."""
    value, error = entry["value"], entry["error"]
    if value is None:
        return ""
    if error is None or error < EXACT:
        return f"{_fixed(100 * value, 1)} %"
    return quoted_share(value, error)


def ratio_text(entry: Content) -> str:
    """Format a ratio, with its error if it has one; empty without a value."""
    value, error = entry["value"], entry["error"]
    if value is None:
        return ""
    if error is None or error < EXACT * value:
        return _fixed(value, 3) if value < 10 else number(value)
    return quoted(value, error)


def _fixed(value: float, places: int) -> str:
    """A number with decimals and a minus sign, without the sign of a negative zero."""
    return f"{round(value, places) + 0.0:.{places}f}".replace("-", MINUS)


def _meta(summary: Content) -> dict[str, Any]:
    keys = ("surveysim", "seed", "scene_sha256", "kind")
    return {"temperature": "CMB", "metric": summary["budget"]["metric"]["key"]} | {key: summary[key] for key in keys}


def _cost_columns(part: str, heading: str, entries: Sequence[Content | None]) -> Iterator[Column]:
    marks = ["" if item is None or item["comparable"] else NOT_COMPARABLE for item in entries]
    none = {"value": None, "error": None}
    ratios, shares = ([item[key] if item else none for item in entries] for key in ("ratio", "time"))
    values, errors = ([item[key] for item in ratios] for key in ("value", "error"))
    yield Column(f"{part}_ratio", values, "", f"{heading}: ratio", tuple(map(ratio_text, ratios)))
    yield file_column(f"{part}_ratio_error", errors)
    yield from _estimates(f"{part}_time", f"{heading}: time", shares, marks)
    for key in ("with", "without"):
        yield file_column(f"{part}_{key}", [-1 if item is None or item[key] is None else item[key] for item in entries])


def _estimates(name: str, heading: str, entries: Sequence[Content], marks: Sequence[str]) -> Iterator[Column]:
    """Columns of shares of the survey time, and of their errors."""
    cells = tuple(text and text + mark for text, mark in zip(map(time_text, entries), marks, strict=True))
    yield Column(name, [item["value"] for item in entries], "", heading, cells)
    yield file_column(f"{name}_error", [item["error"] for item in entries])
