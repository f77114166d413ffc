"""The page of a comparison of runs."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.report.html.captions import COMPARISON
from surveysim.report.html.components import Grid, Page, Picture, Section, Terms, Text, grid, picture
from surveysim.report.html.discarded_scans import warned
from surveysim.runtime.numbers import count, day_and_time, plural, quoted
from surveysim.studies.compare.tables import difference_table, pairing_sentences, quantity_tables, run_table

Content = Mapping[str, Any]  # content of summary.json

_RATIOS = (
    "Ratios are to the first run. A paired error leaves out what the two runs share."
    " Best: the probability that the run has the best value of all that lose few scans and whose error is known."
)


def comparison_page(directory: Path, summary: Content) -> Page:
    """Return the page of a comparison from its directory and summary.json."""
    compared = summary["compared"]
    told, pairs = difference_table(compared), pairing_sentences(compared)[1:]
    same = Text(("No setting differs.",))
    sections = [
        Section("settings", "Settings that differ", (same if told is None else grid(told),)),
        Section("scores", "Scores", (*map(grid, quantity_tables(compared)), Text((_RATIOS, *pairs)))),
        Section("runs", "Runs", (_runs(compared),)),
    ]
    if pictures := tuple(_pictures(directory, summary)):
        sections.append(Section("figures", "Figures", pictures, nested=True))
    sections.append(Section("provenance", "Provenance", (_provenance(summary),)))
    labels = [run["label"] for run in compared["runs"]]
    title = f"{labels[0]} and {labels[1]}" if len(labels) == 2 else plural(len(labels), "run")
    lead = (*_lead(compared), *warned(summary))
    key = (("runs", count(len(labels))), ("settings that differ", count(len(compared["differences"]))))
    return Page("surveysim compare", title, lead, key, tuple(sections))


def _lead(compared: Content) -> Iterator[str]:
    first, *others = compared["runs"]
    entry = next(item for item in compared["quantities"] if item["data_set"] == ACTUAL)
    ratios = zip(others, entry["ratios"][1:], entry["ratio_errors"][1:], strict=True)
    for run, ratio, error in ratios:
        if ratio is not None:
            yield f"{run['label']} has {quoted(ratio, error)} times the σ(A) of {first['label']}."


def _runs(compared: Content) -> Grid:
    return grid(run_table(compared), "Weather: medians over the simulated observations.")


def _pictures(directory: Path, summary: Content) -> Iterator[Picture]:
    for name, caption in COMPARISON.items():
        path = f"figures/{name}.png"
        if path in summary["files"] and (directory / path).is_file():
            lines = (caption.shows, caption.look_for)
            yield picture(directory / path, caption.title, caption.alt, lines)


def _provenance(summary: Content) -> Terms:
    runs = summary["compared"]["runs"]
    pairs = [(run["label"], f"{run['directory']}, scene {run['scene_sha256']}") for run in runs]
    pairs += [("surveysim", summary["surveysim"]), ("Date", day_and_time(summary["run"]["date"]))]
    return Terms(tuple(pairs), "Directories and hashes of the scenes", code=True)
