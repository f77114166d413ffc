"""The page of a budget."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from surveysim.report.html.captions import BUDGET
from surveysim.report.html.components import Block, Page, Section, Terms, Text, grid, picture
from surveysim.report.html.provenance import provenance, sources
from surveysim.report.html.scene import what_was_simulated
from surveysim.results.metric_tables import heading, label
from surveysim.runtime.numbers import count, duration, number, plural, quoted
from surveysim.studies.budget.lines import (
    flag_lines,
    interaction_line,
    least_title,
    measure_line,
    place_line,
    reason_lines,
    small_line,
    total_lines,
)
from surveysim.studies.budget.tables import TITLE, budget_table, pair_table, point_table, time_text

Content = Mapping[str, Any]  # content of summary.json or scene.json
PICTURE = "figures/budget.png"


def budget_page(directory: Path, summary: Content, scene: Content) -> Page:
    """Return the page of a budget from its directory, summary.json and scene.json."""
    notes = (measure_line(summary), place_line(summary), *reason_lines(summary))
    costs = grid(replace(budget_table(summary), title=TITLE), *notes)
    sums = Text(tuple(total_lines(summary)))
    options = tuple((item["title"], item["options"]) for item in summary["budget"]["stages"])
    removal = Terms(options, "Options that remove each stage, and what needs it", code=True)
    sections = [Section("costs", TITLE, (costs, sums, removal))]
    if PICTURE in summary["files"] and (directory / PICTURE).is_file():
        drawn = picture(directory / PICTURE, BUDGET.title, BUDGET.alt, (BUDGET.shows, BUDGET.look_for))
        sections.append(Section("figure", "Figure", (drawn,)))
    if summary["budget"]["pairs"]:
        sections.append(Section("pairs", "Pairs of stages", (grid(pair_table(summary)),)))
    sections += [
        Section("points", "Points", tuple(_points(summary))),
        Section("scene", "What was simulated", what_was_simulated(scene, summary, summary["detectors"])),
        Section("sources", "Where the values come from", sources(scene)),
        Section("provenance", "Provenance", (provenance(summary),)),
    ]
    kind = "surveysim budget" if summary["kind"] == "simulated" else "surveysim budget, by forecast"
    return Page(kind, summary["title"], tuple(_lead(summary)), _key_figures(summary), tuple(sections))


def _lead(summary: Content) -> Iterator[str]:
    stages = [item for item in summary["budget"]["stages"] if item["removed"]["time"]["value"] is not None]
    if stages:
        first = max(stages, key=lambda item: item["removed"]["time"]["value"])
        less, name = time_text(first["removed"]["time"]), label(summary["budget"]["metric"]["key"])
        yield (
            f"{first['title']} costs the most of {plural(len(summary['budget']['stages']), 'stage')}: without it, the"
            f" same {name} takes {less} less survey time."
        )
    yield small_line(summary)
    if line := interaction_line(summary):
        yield line
    yield from summary["warnings"]
    yield from (f"{line[0].upper()}{line[1:]}" for line in flag_lines(summary))


def _key_figures(summary: Content) -> tuple[tuple[str, str], ...]:
    whole, total, run = summary["budget"]["points"][0], summary["budget"]["total"], summary["run"]
    metric = summary["budget"]["metric"]
    value = quoted(whole["value"], whole["error"]) if summary["kind"] == "simulated" else number(whole["value"])
    return (
        (heading(metric["key"], metric["unit"]), value),
        (f"time of {least_title(summary).lower()}", time_text(total["least"])),
        ("interactions", time_text(total["together"])),
        ("points", count(len(summary["budget"]["points"]))),
        ("run time", duration(run["wall_s"])),
        ("workers", count(run["workers"])),
    )


def _points(summary: Content) -> Iterator[Block]:
    command = "run" if summary["kind"] == "simulated" else "forecast"
    note = (
        f"All points have one seed, hence the same weather, noise and skies where the stages allow it. Each can be made"
        f" by itself: surveysim {command} SCENE with its options."
    )
    table = point_table(summary)
    yield grid(replace(table, columns=tuple(item for item in table.columns if item.name != "options")), note)
    points = ((f"{item['point']}", item["options"]) for item in summary["budget"]["points"] if item["options"])
    yield Terms(tuple(points), "Options of each point", code=True)
