"""The page of an explanation of the paper's findings."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from surveysim.report.explanation import (
    difference_table,
    ingredient_table,
    overview_table,
    second_layer_table,
    value_table,
)
from surveysim.report.html.components import Block, Page, Section, Terms, grid, picture
from surveysim.runtime.numbers import count, day_and_time, duration

_RULE = (
    "An ingredient explains a finding if its value agrees with the paper's and that of one layer does not. It helps, or"
    " worsens, if it changes the value by more than three errors, and by more than a tenth of the gap between one layer"
    " and the paper. Values agree within two errors, or within 20 % where the paper gives no error."
)
_PAIRED = "All surveys have the same random numbers. Errors are from resampling the observations, alike in all surveys."


def explanation_page(directory: Path, summary: Mapping[str, Any]) -> Page:
    """Return the page of an explanation from its directory and summary.json."""
    content = summary["explained"]
    sections = (
        Section("overview", "What explains the findings", (grid(overview_table(content), _RULE),)),
        Section(
            "values", "Values", (grid(value_table(content)), grid(difference_table(content), _PAIRED)), nested=True
        ),
        Section("second_layer", "A second layer", tuple(_second_layer(directory, content))),
        Section("ingredients", "Ingredients", (grid(ingredient_table(content)),)),
        Section("provenance", "Provenance", (_provenance(summary),)),
    )
    lead = (
        "Findings of Sayers et al. (2010) that one frozen layer does not reproduce, in simulated surveys with each"
        " ingredient alone and with several together.",
    )
    key = (
        ("observations of each survey", count(content["observations"])),
        ("surveys", count(len(content["ingredients"]))),
    )
    return Page("surveysim paper --explain", "What explains the paper's findings", lead, key, sections)


def _second_layer(directory: Path, content: Mapping[str, Any]) -> Iterator[Block]:
    path = directory / "second_layer.png"
    if path.is_file():
        alt = "Fraction of trusted winds against the share of a second layer, in better and poorer weather"
        yield picture(path, "Trusted winds with a second layer", alt, ())
    yield grid(second_layer_table(content))


def _provenance(summary: Mapping[str, Any]) -> Terms:
    content, run = summary["explained"], summary["run"]
    pairs = [(item["title"], f"scene {item['scene_sha256']}") for item in content["ingredients"]]
    pairs += [("Seed", str(content["seed"])), ("surveysim", summary["surveysim"])]
    pairs += [("Date", day_and_time(run["date"])), ("Engine", run["engine"]), ("Wall time", duration(run["wall_s"]))]
    return Terms(tuple(pairs), "Hashes of the scenes", code=True)
