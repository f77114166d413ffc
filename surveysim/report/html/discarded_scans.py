"""Discarded scans on a page: fractions by data set and by weather, and warnings."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from surveysim.report.html.components import Block, Cell, Grid, Section, Text, cell
from surveysim.runtime.numbers import number
from surveysim.scene.units import b2_unit
from surveysim.survey.discarded_scans import MOST_APART, MOST_DISCARDED, WEATHER_GROUPS, listed_data_sets

Content = Mapping[str, Any]  # content of summary.json or scene.json
DISCARD_RULE = (
    "Cleaning discards a scan whose templates it cannot fit. If it fits responsivities to the atmosphere, these are"
    " scans with little atmospheric signal: in the calmest weather, which gives the best data, or along the wind at"
    " about its speed. A point of a sweep that loses more than"
    f" {100 * MOST_DISCARDED:g} % of them, or {100 * MOST_APART:g} % more than the point that loses least, has no"
    " probability of being the best."
)
QUARTERS = "Quarters of the observations by their B2, the calmest first."


def share_cell(share: float | None) -> Cell:
    """Make a cell of a fraction in percent; empty for NaN and None."""
    return Cell("") if share is None or math.isnan(share) else Cell(f"{100 * share:.1f}", 100 * share)


def quarter_names(n: int) -> list[str]:
    """Name n groups of observations, ordered by weather."""
    kind = "quarter" if n == WEATHER_GROUPS else "group"
    return [f"{place} {kind}" for place in ("1st", "2nd", "3rd", "4th")[:n]]


def warned(summary: Content) -> Iterator[str]:
    """Return the warnings in a summary as paragraphs."""
    for line in summary.get("warnings", ()):
        yield f"Warning: {line}"


def discarded_section(summary: Content, scene: Content) -> Section:
    """Return the fractions of discarded scans of a run, for all observations and for quarters of them."""
    return Section("discarded", "Discarded scans", tuple(_blocks(summary, scene)))


def _blocks(summary: Content, scene: Content) -> Iterator[Block]:
    shares, by_weather = summary["discarded"], summary["discarded_by_weather"]
    if "samples_lost" in summary:
        lost = (
            f"{100 * summary['samples_lost']:.1f} % of the samples of all detectors are lost, and left out of the map."
        )
        yield Text((lost,))
    if not any(shares.values()):
        yield Text(("No scan was discarded.",))
        return
    names = listed_data_sets([shares, *(part["discarded"] for part in by_weather)])
    rows = []
    for name, part in zip(quarter_names(len(by_weather)), by_weather, strict=True):
        b2 = f"{number(part['b2_min_mk2'])} to {number(part['b2_max_mk2'])}"
        rows.append((cell(name), Cell(b2), cell(part["observations"]), *_cells(part["discarded"], names)))
    rows.append((cell("all"), Cell(""), cell(summary["observations"]), *_cells(shares, names)))
    unit = f" [{b2_unit(scene['atmosphere']['spectral_index'])}]" if by_weather else ""
    columns = ("observations by B2", f"B2{unit}", "number", *(f"{name} [%]" for name in names))
    title = "Share of the scans that cleaning discards"
    notes = (DISCARD_RULE, QUARTERS) if by_weather else (DISCARD_RULE,)
    yield Grid("discarded-table", title, columns, tuple(rows), notes)


def _cells(shares: Mapping[str, float], names: list[str]) -> list[Cell]:
    return [share_cell(shares[name]) for name in names]
