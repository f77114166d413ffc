"""The page of a convergence study."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from surveysim.report.html.captions import ACCURACY
from surveysim.report.html.components import (
    UK2,
    Block,
    Listing,
    Page,
    Section,
    Text,
    grid,
    picture,
)
from surveysim.report.html.discarded_scans import warned
from surveysim.report.html.provenance import provenance, sources
from surveysim.report.html.scene import what_was_simulated
from surveysim.report.tables import could_run, setting_table
from surveysim.runtime.numbers import count, duration, number, percent, with_error

Content = Mapping[str, Any]  # content of summary.json or scene.json
PICTURE = "figures/accuracy.png"


def accuracy_page(directory: Path, summary: Content, scene: Content) -> Page:
    """Return the page of a convergence study from its directory, summary.json and scene.json."""
    from astropy.table import Table

    table, found = Table.read(directory / "accuracy.ecsv", format="ascii.ecsv"), summary["accuracy"]
    rows = [dict(zip(table.colnames, row.as_void().tolist(), strict=True)) for row in table]
    scored = [row for row in rows if could_run(row)]
    sections = [Section("settings", "Accuracy and cost of every setting", tuple(_settings(rows, scored, found)))]
    if PICTURE in summary["files"] and (directory / PICTURE).is_file():
        lines = (ACCURACY.shows, ACCURACY.look_for)
        drawn = picture(directory / PICTURE, ACCURACY.title, ACCURACY.alt, lines)
        sections.append(Section("figure", "Error against run time", (drawn, *_slopes(found))))
    else:
        sections.append(Section("figure", "Error against run time", tuple(_slopes(found))))
    what = what_was_simulated(scene, summary, summary["detectors"])
    sections += [
        Section("scene", "What was simulated", what),
        Section("sources", "Where the values come from", sources(scene)),
        Section("provenance", "Provenance", (provenance(summary),)),
    ]
    own = next((row for row in scored if row["kind"] == "survey" and row["own"]), None)
    key = [(f"reference σ(A) [{UK2}]", number(found["reference_ukcmb2"], 4))]
    key += [("known to", percent(found["reference_error"]))]
    if own is not None:
        key.append(("error of one run", percent(own["error_ukcmb2"] / own["sigma_ukcmb2"])))
    key += [("settings", count(len(rows))), ("run time", duration(summary["run"]["wall_s"]))]
    title = f"{summary['title']}: accuracy and its cost"
    lead = (*_lead(found), *warned(summary))
    return Page("surveysim accuracy", title, lead, tuple(key), tuple(sections))


def _lead(found: Content) -> Iterator[str]:
    others = [f"{item['parameter']} {item['label']}" for item in found["recommended"] if not item["is_own"]]
    tolerated = f"a bias below {percent(found['tolerated_bias'])}, a third of the run's Monte Carlo error"
    text = f"The scene's own settings are the fastest with {tolerated}"
    yield f"{text}, but for: {'; '.join(others)}." if others else f"{text}."
    yield " ".join(f"{_sentence(line.strip())}." for line in found["reference"])


def _settings(rows: Sequence[Content], scored: Sequence[Content], found: Content) -> Iterator[Block]:
    note = (
        "Shaded: the scene's own settings. A bias is against the finest setting of its parameter (of the number of"
        " observations and the forecast: against the reference), with its paired error; 0 without an error is that"
        " setting itself, or one equal to it. Peak: the most memory that a process held since it began, with other"
        " settings before this one."
    )
    if scored:
        yield grid(setting_table(scored), note)
    refused = [row for row in rows if not could_run(row)]
    if refused:
        yield Listing(tuple(f"{row['parameter']} {row['setting']}: {row['note']}." for row in refused), "Not run:")
    tolerated = percent(found["tolerated_bias"])
    yield Listing(
        tuple(map(_recommended, found["recommended"])), f"Recommended, fastest with a bias below {tolerated}:"
    )


def _slopes(found: Content) -> Iterator[Block]:
    items = tuple(f"{item['name']}: {with_error(item['value'], item['error'])}" for item in found["slopes"])
    if items:
        yield Listing(items, "Slopes in logarithms; that of a Monte Carlo is −0.5:")
    else:
        yield Text(("Too few settings could be run to measure how errors fall with time.",))


def _recommended(item: Content) -> str:
    has = "as the scene has it" if item["is_own"] else "not the scene's"
    doubt = "" if item["resolved"] else "; its bias is smaller than its error, but the error is larger than this limit"
    return f"{item['parameter']} {item['label']}: {has}{doubt}."


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."
