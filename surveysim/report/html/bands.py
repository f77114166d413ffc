"""The page of a camera of several bands: one table, with links to the pages of the bands."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from surveysim.report.html.components import Cell, Grid, Page, Section, grid
from surveysim.report.html.discarded_scans import warned
from surveysim.report.html.provenance import provenance
from surveysim.results.bands import band_table
from surveysim.runtime.numbers import count, duration, joined, plural

Content = Mapping[str, Any]  # content of summary.json


def bands_page(directory: Path, summary: Content) -> Page:
    """Return the page of a camera from its directory and summary.json."""
    bands = summary["bands"]
    notes = [f"{name} is not scored: {row['unscored']}." for name, row in bands.items() if row.get("unscored")]
    notes.append(
        "The bands see one layer and one sky, so their errors are not independent. Correlations between the maps of"
        " different bands are not computed."
    )
    table = _with_links(grid(band_table(bands, {}), *notes))
    sections = (Section("bands", "Bands", (table,)), Section("provenance", "Provenance", (provenance(summary),)))
    detectors = sum(row["detectors"] for row in bands.values())
    observations = plural(summary["observations_of_survey"], "observation")
    made = f"A camera of {plural(detectors, 'detector')} in the bands {joined(list(bands))}, {observations} of each."
    if any("points" in row for row in bands.values()):
        made = f"A sweep of {plural(len(bands), 'band')}, {joined(list(bands))}. Scores are those of the best point."
    lead = (f"{made} Every band has a page of its own.", *warned(summary))
    time = duration(summary["run"]["wall_s"])
    key = (("bands", count(len(bands))), ("detectors", count(detectors)), ("run time", time))
    return Page("surveysim run", summary["title"], lead, key, sections)


def _with_links(table: Grid) -> Grid:
    """Make the name of each band a link to its page."""
    rows = tuple((Cell(row[0].text, link=f"bands/{row[0].text}/report.html"), *row[1:]) for row in table.rows)
    return replace(table, rows=rows)
