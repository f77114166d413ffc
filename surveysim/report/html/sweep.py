"""The page of a sweep."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.html.captions import FORECAST_SWEEP, SWEEP
from surveysim.report.html.components import UK2, Block, Cell, Grid, Page, Section, Terms, Text, cell, grid, picture
from surveysim.report.html.discarded_scans import DISCARD_RULE, QUARTERS, quarter_names, share_cell, warned
from surveysim.report.html.provenance import provenance, sources
from surveysim.report.html.scene import what_was_simulated
from surveysim.results.metric_tables import label, with_unit
from surveysim.runtime.numbers import count, duration, joined, number, plural, quoted, quoted_share
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.studies.sweep.axes import value_text
from surveysim.studies.sweep.result import ESTIMATES, FORECAST_WEATHER
from surveysim.studies.sweep.tables import (
    WITHHELD,
    chance_text,
    data_set_table,
    ratio_text,
    stop_sentence,
    sweep_table,
    varied_keys,
)
from surveysim.survey.discarded_scans import MOST_APART, MOST_DISCARDED, listed_data_sets

Content = Mapping[str, Any]  # content of summary.json, of one of its points, or of scene.json
PICTURE = "figures/sweep.png"
MOST_NAMED = 4  # points in a note
NO_DISCARD_FORECAST = "By forecast no scan is discarded."


def sweep_page(directory: Path, summary: Content, scene: Content) -> Page:
    """Return the page of a sweep from its directory, summary.json and scene.json."""
    sections = [
        Section("axes", "What was varied", _axes(summary)),
        Section("points", "Points", tuple(_grids(summary))),
    ]
    if PICTURE in summary["files"] and (directory / PICTURE).is_file():
        caption = SWEEP if summary["kind"] == "simulated" else FORECAST_SWEEP
        drawn = picture(directory / PICTURE, caption.title, caption.alt, (caption.shows, caption.look_for))
        sections.append(Section("figure", "Figure", (drawn,)))
    if found := tuple(_pair_grids(summary)):
        sections.append(Section("pairs", "Every point against every other", found))
    if discarded := tuple(_discarded(summary)):
        sections.append(Section("discarded", "Discarded scans", discarded))
    if agreement := _agreement(summary):
        sections.append(Section("agreement", "Forecast against simulation", (agreement,)))
    first = Text(("The scene of the first point; the others differ in the keys that are varied, and in what follows.",))
    what = what_was_simulated(scene, summary, summary["points"][0]["n_det"])
    sections += [
        Section("scene", "What was simulated", (first, *what)),
        Section("sources", "Where the values come from", sources(scene)),
        Section("provenance", "Provenance", (provenance(summary), _hashes(summary))),
    ]
    kind = "surveysim sweep" if summary["kind"] == "simulated" else "surveysim sweep, by forecast"
    return Page(kind, summary["title"], tuple(_lead(summary, scene)), _key_figures(summary), tuple(sections))


def _lead(summary: Content, scene: Content) -> Iterator[str]:
    points, best = summary["points"], [summary["points"][number] for number in summary["best"]]
    names = joined([axis["name"] for axis in summary["axes"]])
    made = f"{plural(len(points), 'point')} along {names}"
    if not best:
        yield f"{made}; none has a score."
        yield from warned(summary)
        return
    yield _best_sentence(summary, made, best)
    reference = points[summary["reference"]]
    if reference not in best:
        ratio = ratio_text(best[0], None)
        yield f"That is {ratio} times the {_name(summary)} of the reference point, {reference['label']}."
    if stopped := stop_sentence(summary):
        yield stopped
    if summary["kind"] == "simulated":
        yield (
            f"Every point has up to {plural(scene['observations'], 'observation')} with the same seed, hence the same"
            " weather, noise and skies where the keys allow it. Ratios therefore have smaller errors than the points."
        )
    yield from warned(summary)


def _name(summary: Content) -> str:
    """Name of the quantity that points are compared by."""
    return label(summary["metric"]["key"]).replace("sigma", "σ")


def _side(summary: Content) -> str:
    return "lowest" if summary["metric"]["lower_is_better"] else "highest"


def _value(summary: Content, point: Content) -> str:
    """That quantity at a point, with its error and unit."""
    entry = point["metrics"][summary["metric"]["key"]]
    text = quoted(entry["value"], entry["error"]) if "value" in entry else number(entry["forecast"])
    unit = summary["metric"]["unit"]
    return f"{text} {UK2}" if unit == "uK2" else with_unit(text, unit)


def _best_sentence(summary: Content, made: str, best: list[Content]) -> str:
    labels = " or ".join(point["label"] for point in best)
    if summary["kind"] != "simulated":
        return f"Of {made}, the best by forecast is {labels}: {_name(summary)} = {_value(summary, best[0])}."
    found = f"{_name(summary)} = {_value(summary, best[0])}"
    if WITHHELD in best[0]:
        why = best[0][WITHHELD]
        side = _side(summary)
        return f"Of {made}, the {side} is {labels}: {found}. The probability that it is the best is withheld: {why}."
    sure, each = best[0]["best_probability"], "each " if len(best) > 1 else ""
    out = sum(WITHHELD in point for point in summary["points"])
    others = f" {plural(out, 'point')} that lose too many scans are not counted." if out else ""
    return f"Of {made}, the best is {labels}: {found}, {each}with a confidence of {chance_text(sure)}.{others}"


def _key_figures(summary: Content) -> tuple[tuple[str, str], ...]:
    run, found = summary["run"], []
    if summary["best"]:
        best = summary["points"][summary["best"][0]]
        ratio = ratio_text(best, summary["reference"])
        name = _side(summary) if WITHHELD in best else "best"
        found += [(f"{name} {_name(summary)}", _value(summary, best)), ("over the reference", ratio)]
    found += [("points", count(len(summary["points"]))), ("axes", count(len(summary["axes"])))]
    return (*found, ("run time", duration(run["wall_s"])), ("workers", count(run["workers"])))


def _axes(summary: Content) -> tuple[Block, ...]:
    pairs = []
    for axis in summary["axes"]:
        for key, values in zip(axis["keys"], zip(*axis["values"], strict=True), strict=True):
            pairs.append((key, ", ".join(value_text(value) for value in values)))
    together = [joined(axis["keys"]) for axis in summary["axes"] if len(axis["keys"]) > 1]
    lines = tuple(f"{keys} change together." for keys in together)
    return (Terms(tuple(pairs)), *((Text(lines),) if lines else ()))


def _grids(summary: Content) -> Iterator[Block]:
    notes = [_ratio_note(summary)]
    notes += [f"{point['label']}: {point['unscored']}." for point in summary["points"] if point.get("unscored")]
    reasons = dict.fromkeys(point[WITHHELD] for point in summary["points"] if WITHHELD in point)
    for reason in reasons:
        labels = [point["label"] for point in summary["points"] if point.get(WITHHELD) == reason]
        of = joined(labels) if len(labels) <= MOST_NAMED else plural(len(labels), "point")
        notes.append(f"Withheld for {of}: {reason}.")
    notes += [
        f"The forecast of {point['label']} may be off: {sentence}"
        for point in summary["points"]
        for sentence in point["forecast_flags"]
    ]
    table = replace(sweep_table(summary), title="Uncertainty of a flat CMB band power, actual data")
    yield _with_links(grid(table, *notes), summary)
    if others := data_set_table(summary):
        yield grid(others)


def _with_links(table: Grid, summary: Content) -> Grid:
    """Make the first cell of each point a link to the page of its results, if they are kept."""
    links = [f"{point['directory']}/report.html" if "directory" in point else "" for point in summary["points"]]
    rows = zip(table.rows, links, strict=True)
    return replace(table, rows=tuple((replace(row[0], link=link), *row[1:]) for row, link in rows))


def _values(point: Content, keys: list[str]) -> str:
    return ", ".join(value_text(point["settings"][key]) for key in keys)


def _ratio_note(summary: Content) -> str:
    if summary["reference"] is None:
        return "No point has a score, so there are no ratios."
    said = ESTIMATES.get(summary["estimate"])
    note = f"σ(A) {said}. " if said else ""
    note += "" if summary["metric"]["key"] == SIGMA_KEY else f"Ratios are of {_name(summary)}. "
    note += f"Ratios are to {summary['points'][summary['reference']]['label']}."
    if summary["kind"] != "simulated":
        return f"{note} A forecast has no Monte Carlo error. {FORECAST_WEATHER}"
    return (
        f"{note} Their errors allow for the noise and weather that the points share. Best: the probability that the"
        f" point has the {_side(summary)} {_name(summary)} of all that lose few scans and whose error is known."
    )


def _pair_grids(summary: Content) -> Iterator[Grid]:
    """Ratios of all pairs, row over column."""
    pairs = {(pair["point"], pair["other"]): pair for pair in summary["pairs"]}
    numbers = sorted({number for pair in pairs for number in pair})
    if len(numbers) < 3:  # the table of points has the only pair
        return
    names = {number: f"{number}: {_values(summary['points'][number], varied_keys(summary))}" for number in numbers}
    rows = tuple((cell(names[row]), *(_pair_cell(pairs, row, column) for column in numbers)) for row in numbers)
    notes = [f"{_name(summary)} of the row's point over the column's, with the paired error."]
    if not all(pair["comparable"] for pair in pairs.values()):
        notes.append(
            f"*: not to be compared, as one loses more than {100 * MOST_DISCARDED:g} % of its scans or the two differ"
            f" by more than {100 * MOST_APART:g} %."
        )
    columns = ("point", *(str(number) for number in numbers))
    yield Grid("pair-table", f"Ratios of {_name(summary)}", columns, rows, tuple(notes))


def _pair_cell(pairs: Mapping[tuple[int, int], Content], row: int, column: int) -> Cell:
    if row == column:
        return Cell("1", 1.0)
    pair = pairs.get((row, column)) or pairs[column, row]
    ratio, error = pair["ratio"], pair["paired_error"]
    if (row, column) not in pairs:
        ratio, error = 1 / ratio, None if error is None else error / ratio**2
    return Cell(quoted(ratio, error) + ("" if pair["comparable"] else " *"), ratio)


def _discarded(summary: Content) -> Iterator[Block]:
    """Fractions of discarded scans at each point: by data set, and of the actual data by weather."""
    points = [point for point in summary["points"] if "discarded" in point]
    if not points:
        return
    keys, names = varied_keys(summary), listed_data_sets([point["discarded"] for point in points])
    if not any(value for point in points for value in point["discarded"].values()):
        unknown = [point["label"] for point in summary["points"] if "discarded" not in point]
        more = (f"The fraction is unknown for {joined(unknown)}.",) if unknown else ()
        yield Text(("No scan was discarded." if summary["kind"] == "simulated" else NO_DISCARD_FORECAST, *more))
        return
    quarters = max(len(point["discarded_by_weather"]) for point in points)
    rows = []
    for point in points:
        by_weather = [part["discarded"][ACTUAL] for part in point["discarded_by_weather"]]
        by_weather += [math.nan] * (quarters - len(by_weather))
        shares = [point["discarded"].get(name, math.nan) for name in names]
        rows.append((cell(_values(point, keys)), *map(share_cell, (*shares, *by_weather))))
    columns = ["point", *(f"{name} [%]" for name in names)]
    columns += [f"{ACTUAL}, {name} [%]" for name in quarter_names(quarters)]
    notes = (DISCARD_RULE, QUARTERS) if quarters else (DISCARD_RULE,)
    yield Grid("discarded-table", "Share of the scans that cleaning discards", tuple(columns), tuple(rows), notes)


def _agreement(summary: Content) -> Grid | None:
    """Forecast over simulation, minus 1, of each point that has both."""
    rows = []
    for point in summary["points"]:
        if off := point.get("forecast_over_simulated"):
            ratio = Cell(quoted_share(off["sigma"], off["sigma_error"]), off["sigma"])
            rows.append((cell(_values(point, varied_keys(summary))), ratio))
    columns = ("point", "forecast over simulated, less 1")
    note = (
        "Both are of the same observations and of the scans that were kept. Errors are those of the ratio; the points"
        " have one seed, so they are not independent of each other."
    )
    return Grid("agreement-table", "σ(A) of the actual data", columns, tuple(rows), (note,)) if rows else None


def _hashes(summary: Content) -> Terms:
    pairs = tuple((f"Point {point['point']}", point["scene_sha256"]) for point in summary["points"])
    return Terms(pairs, "Hashes of the points' scenes", code=True)
