"""The page of a sweep: which point is best, the axes, all points, the figure, the scene, provenance."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from surveysim.recipes import ACTUAL
from surveysim.report.captions import FORECAST_SWEEP, SWEEP
from surveysim.report.page_parts import (
    UK2,
    Block,
    Cell,
    Grid,
    Page,
    Section,
    Terms,
    Text,
    as_known,
    cell,
    count,
    duration,
    joined,
    measured,
    number,
    picture,
    plural,
    with_error,
)
from surveysim.report.page_provenance import provenance, sources
from surveysim.report.page_run import what_was_simulated
from surveysim.sweep import value_text
from surveysim.trade import SURE

Content = Mapping[str, Any]  # of summary.json and scene.json, or of a point in the former
PICTURE = "figures/sweep.png"


def sweep_page(directory: Path, summary: Content, scene: Content) -> Page:
    """The page of what a sweep left in a directory."""
    sections = [
        Section("axes", "What was varied", _axes(summary)),
        Section("points", "Points", tuple(_grids(summary))),
    ]
    if PICTURE in summary["files"] and (directory / PICTURE).is_file():
        caption = SWEEP if summary["kind"] == "simulated" else FORECAST_SWEEP
        drawn = picture(directory / PICTURE, caption.title, caption.alt, (caption.shows, caption.look_for))
        sections.append(Section("figure", "Figure", (drawn,)))
    if found := _agreement(summary):
        sections.append(Section("truth", "Forecast against simulation", (found,)))
    first = Text(("The scene of the first point; the others differ in the keys that are varied, and in what follows.",))
    what = what_was_simulated(scene, summary, summary["points"][0]["n_det"])
    sections += [
        Section("scene", "What was simulated", (first, *what)),
        Section("sources", "Where the values come from", sources(scene)),
        Section("provenance", "Provenance", (provenance(summary), _hashes(summary))),
    ]
    kind = "surveysim sweep" if summary["kind"] == "simulated" else "surveysim sweep, by forecast"
    return Page(kind, summary["title"], tuple(_lead(summary, scene)), _key_figures(summary), tuple(sections))


def label(summary: Content, point: Content) -> str:
    """A point by the first key of each axis: ``key = value, ...``."""
    keys = [(axis["name"], axis["keys"][0]) for axis in summary["axes"]]
    return ", ".join(f"{name} = {value_text(point['settings'][key])}" for name, key in keys)


def _lead(summary: Content, scene: Content) -> Iterator[str]:
    points, best = summary["points"], [summary["points"][number] for number in summary["best"]]
    names = joined([axis["name"] for axis in summary["axes"]])
    made = f"{plural(len(points), 'point')} along {names}"
    if not best:
        yield f"{made}; none has a score."
        return
    labels = " or ".join(label(summary, point) for point in best)
    if summary["kind"] == "simulated":
        row, sure = best[0]["scores"][ACTUAL], best[0]["best_probability"]
        confidence = f"more than {100 * SURE:g} %" if sure > SURE else f"{100 * sure:.0f} %"
        each = "each " if len(best) > 1 else ""
        sigma = with_error(row["sigma_ukcmb2"], row["error_ukcmb2"])
        yield f"Of {made}, the best is {labels}: σ(A) = {sigma} {UK2}, {each}with a confidence of {confidence}."
    else:
        sigma = number(best[0]["forecast_ukcmb2"][ACTUAL])
        yield f"Of {made}, the best by forecast is {labels}: σ(A) = {sigma} {UK2}."
    reference = points[summary["reference"]]
    if reference not in best:
        ratio = with_error(best[0]["ratio"], best[0].get("ratio_error"))
        yield f"That is {ratio} times the σ(A) of the reference point, {label(summary, reference)}."
    if summary["kind"] == "simulated":
        yield (
            f"Every point has up to {plural(scene['observations'], 'observation')} with the same seed, hence the same"
            " weather, noise and skies wherever the keys allow it. Ratios are therefore known better than the points."
        )


def _key_figures(summary: Content) -> tuple[tuple[str, str], ...]:
    run, found = summary["run"], []
    if summary["best"]:
        best = summary["points"][summary["best"][0]]
        row = best["scores"].get(ACTUAL)
        sigma = with_error(row["sigma_ukcmb2"], row["error_ukcmb2"]) if row else number(best["forecast_ukcmb2"][ACTUAL])
        ratio = "1" if best["point"] == summary["reference"] else with_error(best["ratio"], best.get("ratio_error"))
        found += [(f"best σ(A) [{UK2}]", sigma), ("over the reference", ratio)]
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
    keys = _keys(summary)
    simulated = summary["kind"] == "simulated"
    columns = ["point", *(f"σ(A) [{UK2}]",) * simulated, "forecast", "ratio"]
    columns += ["ratio, if independent", "best [%]"] * simulated + ["detectors"]
    rows = tuple((cell(_values(point, keys)), *_numbers(summary, point)) for point in summary["points"])
    named = f"The point's name has the values of {joined(keys)}. "
    notes = [named + _ratio_note(summary)]
    notes += [f"{label(summary, point)}: {point['unscored']}." for point in summary["points"] if point.get("unscored")]
    notes += [
        f"The forecast of {label(summary, point)} may be off: {sentence}"
        for point in summary["points"]
        for sentence in point["forecast_flags"]
    ]
    caption = "Uncertainty of a flat CMB band power, actual data"
    yield Grid("point-table", caption, tuple(columns), rows, tuple(notes), tuple(summary["best"]))
    others = list(dict.fromkeys(name for point in summary["points"] for name in point["scores"] if name != ACTUAL))
    if others:
        rows = tuple((cell(_values(point, keys)), *_others(point, others)) for point in summary["points"])
        yield Grid("other-table", f"Other data sets: σ(A) [{UK2}]", ("point", *others), rows)


def _keys(summary: Content) -> list[str]:
    return [key for axis in summary["axes"] for key in axis["keys"]]


def _values(point: Content, keys: list[str]) -> str:
    return ", ".join(value_text(point["settings"][key]) for key in keys)


def _numbers(summary: Content, point: Content) -> Iterator[Cell]:
    score, scored = point["scores"].get(ACTUAL), "ratio" in point
    forecast, own = point["forecast_ukcmb2"].get(ACTUAL), point["point"] == summary["reference"]
    if summary["kind"] == "simulated":
        yield measured(score["sigma_ukcmb2"], score["error_ukcmb2"]) if score else Cell("not scored")
    known = score and score["error_ukcmb2"] > 0
    shown = "" if forecast is None else as_known(forecast, score["error_ukcmb2"]) if known else number(forecast)
    yield Cell(shown, forecast)
    yield Cell("1", point["ratio"]) if own else measured(point.get("ratio"), point.get("ratio_error"))
    if summary["kind"] == "simulated":
        yield Cell("1", point["ratio"]) if own else measured(point.get("ratio"), point.get("independent_error"))
        yield Cell(_probability(point["best_probability"]), point["best_probability"]) if scored else Cell("")
    yield cell(point["n_det"])


def _probability(share: float) -> str:
    """In percent; never 0 or 100, which draws can't tell."""
    if share > SURE:
        return f"> {100 * SURE:g}"
    return "< 0.5" if share < 1 - SURE else f"{100 * share:.0f}"


def _others(point: Content, names: list[str]) -> Iterator[Cell]:
    for name in names:
        score = point["scores"].get(name)
        yield measured(score["sigma_ukcmb2"], score["error_ukcmb2"]) if score else Cell("")


def _ratio_note(summary: Content) -> str:
    if summary["reference"] is None:
        return "No point has a score, so there are no ratios."
    note = f"Ratios are to {label(summary, summary['points'][summary['reference']])}."
    if summary["kind"] != "simulated":
        return f"{note} A forecast has no Monte Carlo error."
    return (
        f"{note} Their errors count what the points have in common; beside stand those that independent runs would"
        " have. Best: the probability that the point has the lowest σ(A) of all."
    )


def _agreement(summary: Content) -> Grid | None:
    """Forecast over simulated, less 1, of every point that has both."""
    rows = []
    for point in summary["points"]:
        if off := point.get("forecast_over_simulated"):
            ratio = measured(100 * off["sigma"], 100 * off["sigma_error"])
            rows.append((cell(_values(point, _keys(summary))), ratio))
    columns = ("point", "forecast over simulated, less 1 [%]")
    note = (
        "Both are of the same observations and of the scans that were kept. Errors are those of the ratio; the points"
        " have one seed, so they are not independent of each other."
    )
    return Grid("agreement-table", "σ(A) of the actual data", columns, tuple(rows), (note,)) if rows else None


def _hashes(summary: Content) -> Terms:
    pairs = tuple((f"Point {point['point']}", point["scene_sha256"]) for point in summary["points"])
    return Terms(pairs, "Hashes of the points' scenes", code=True)
