"""The page of an optimisation."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from surveysim.report.html.captions import FRONT, OPTIMUM, SIMULATED_DESIGNS
from surveysim.report.html.components import Block, Listing, Page, Section, Text, grid, picture
from surveysim.report.html.discarded_scans import warned
from surveysim.report.html.provenance import provenance, sources
from surveysim.report.html.scene import what_was_simulated
from surveysim.runtime.numbers import count, duration, plural
from surveysim.studies.optimise.tables import (
    design_table,
    front_table,
    metric_text,
    optimum_table,
    simulated_table,
    value_shown,
)
from surveysim.studies.sweep.axes import value_text

Content = Mapping[str, Any]  # content of summary.json or scene.json
RIVALS = (
    "Rivals are other local optima, named by the choices that differ, and the ends of the ranges within 1 %: "
    "'speed high' is the upper end for a key that ends in speed, 'speed low' the lower one."
)


def optimum_page(directory: Path, summary: Content, scene: Content) -> Page:
    """Return the page of an optimisation from its directory, summary.json and scene.json."""
    found = summary["optimum"]
    two = bool(found["front"])
    sections = [Section("optimum", "Best design", tuple(_best(directory, summary)))]
    if two:
        sections.append(Section("front", "Pareto front", tuple(_front(directory, summary))))
    if "simulated" in summary:
        sections.append(
            Section("simulated", "The best design and its rivals, simulated", tuple(_simulated(directory, summary)))
        )
    n_det = summary["simulated"]["points"][0]["n_det"] if "simulated" in summary else found["detectors"]
    sections += [
        Section("search", "How it was searched", tuple(_search(summary))),
        Section("scene", "The scene as it is", what_was_simulated(scene, summary, n_det)),
        Section("sources", "Where the values come from", sources(scene)),
        Section("provenance", "Provenance", (provenance(summary),)),
    ]
    units = {item["key"]: f" [{item['unit']}]" if item["unit"] else "" for item in found["metrics"]}
    key = [(f"{name}{unit}", metric_text(_value(found, name))) for name, unit in units.items()]
    key += [("designs forecast", count(found["evaluations"])), ("run time", duration(summary["run"]["wall_s"]))]
    return Page(
        "surveysim optimise", f"{summary['title']}: best design", tuple(_lead(summary)), tuple(key), tuple(sections)
    )


def _lead(summary: Content) -> Iterator[str]:
    found = summary["optimum"]
    knobs = ", ".join(f"{item['key']} = {value_shown(item['best'])}" for item in found["knobs"])
    metrics = " and ".join(
        f"{item['key']} = {metric_text(_value(found, item['key']))} {item['unit']}".strip() for item in found["metrics"]
    )
    which = "The design closest to the best of both metrics" if found["front"] else "The best design by forecast"
    yield f"{which} has {knobs}: {metrics}."
    if "simulated" in summary and (best := _simulated_best(summary["simulated"])):
        yield best
    yield from warned(summary)


def _value(found: Content, key: str) -> float:
    """Metric of the best design, without the noise of the forecast where that is known."""
    smoothed = found["best"].get("smoothed")
    return found["best"]["metrics"][key] if smoothed is None else smoothed


def _simulated_best(sweep: Content) -> str:
    names = [sweep["points"][point]["label"].removeprefix("design = ") for point in sweep["best"]]
    return (
        f"Of {plural(len(sweep['points']), 'design')} that were simulated, the lowest is: {' or '.join(names)}."
        if names
        else ""
    )


def _best(directory: Path, summary: Content) -> Iterator[Block]:
    found = summary["optimum"]
    notes = ["Ranges within 1 %: one knob is moved, the others stay at the best design."] if not found["front"] else []
    if "scatter" in found:
        notes.append(
            f"Forecasts scatter by {100 * found['scatter']:.2g} % about a smooth surface near the best design."
        )
    yield grid(replace(optimum_table(summary), title="Knobs"), *notes)
    if not found["front"]:
        yield from _picture(directory, summary, "optimum", OPTIMUM)
    yield grid(design_table(summary), "Ratios and errors of simulated designs are below." * ("simulated" in summary))


def _front(directory: Path, summary: Content) -> Iterator[Block]:
    yield from _picture(directory, summary, "optimum", FRONT)
    yield grid(front_table(summary))


def _simulated(directory: Path, summary: Content) -> Iterator[Block]:
    yield grid(
        simulated_table(summary),
        "Ratios are to the first design, with paired errors: all designs have one seed.",
        *([] if summary["optimum"]["front"] else [RIVALS]),
    )
    yield from _picture(directory, summary, "simulated", SIMULATED_DESIGNS)


def _picture(directory: Path, summary: Content, name: str, caption: Any) -> Iterator[Block]:
    path = f"figures/{name}.png"
    if path in summary["files"] and (directory / path).is_file():
        yield picture(directory / path, caption.title, caption.alt, (caption.shows, caption.look_for))


def _search(summary: Content) -> Iterator[Block]:
    found = summary["optimum"]
    yield Text(
        (
            f"{plural(found['evaluations'], 'design')} were forecast: Sobol' points over the ranges of the knobs, then"
            " descents by quadratic models in a trust region (COBYQA), then designs along each knob.",
        )
    )
    if found["limits"]:
        yield Listing(tuple(map(_bounds, found["limits"])), "Limits:")
    if found["refused"]:
        yield Listing(
            tuple(f"{reason}: {plural(n, 'design')}" for reason, n in found["refused"].items()), "Not allowed:"
        )


def _bounds(limit: Content) -> str:
    words = {"at_least": "at least", "at_most": "at most"}
    bounds = [f"{word} {value_text(limit[name])}" for name, word in words.items() if name in limit]
    return f"{limit['quantity']}: {' and '.join(bounds)}"
