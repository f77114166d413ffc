"""Tables of an explanation: all entries for files, an overview for people."""

from collections.abc import Mapping, Sequence

import numpy as np

from surveysim.paper.explain.comparison import EXPLAINS, HELPS, Entry
from surveysim.paper.explain.findings import Finding
from surveysim.paper.explain.ingredients import ONE_LAYER, Ingredient
from surveysim.paper.explain.values import Values
from surveysim.runtime.numbers import short, with_error
from surveysim.runtime.table import Column, Table, column, file_column

Entries = Mapping[tuple[str, str], Entry]  # by names of finding and ingredient
UNITS = {"drawn_b2": "mK2 rad(-5/3)", "raw_mk2": "mK2"} | dict.fromkeys(
    ("fitted_b2", "lowest_layer_b2", "highest_layer_b2"), "mK2 rad(-5/3)"
)


def entry_table(findings: Sequence[Finding], items: Sequence[Ingredient], entries: Entries) -> Table:
    """Return a row for each finding and ingredient, for files."""
    pairs = [(finding, item) for finding in findings for item in items]
    found = [entries[finding.name, item.name] for finding, item in pairs]
    columns = (
        file_column("finding", [finding.name for finding, _ in pairs]),
        file_column("ingredient", [item.name for _, item in pairs]),
        file_column("paper", [finding.paper for finding, _ in pairs]),
        file_column("paper_error", [finding.paper_error for finding, _ in pairs]),
        *(file_column(name, [getattr(entry, name) for entry in found]) for name in Entry.__dataclass_fields__),
    )
    meta = {"title": "Findings of the paper with each ingredient", "titles": {x.name: x.title for x in findings}}
    return Table("explain", meta["title"], columns, meta=meta)


def overview_table(findings: Sequence[Finding], items: Sequence[Ingredient], entries: Entries) -> Table:
    """Return a row for each finding: paper, one layer, best combination, and the ingredients that explain or help."""
    last = items[-1]
    columns = (
        column("finding", [finding.title for finding in findings], "finding"),
        _paper(findings),
        _values(findings, items[0], entries),
        *(_verdicts(findings, items[1:-1], entries, verdict) for verdict in (EXPLAINS, HELPS)),
        _values(findings, last, entries),
    )
    return Table("overview", "Findings of the paper, and the ingredients that explain them", columns)


def value_table(findings: Sequence[Finding], items: Sequence[Ingredient], entries: Entries) -> Table:
    """Return a row for each finding, with its value for each ingredient."""
    columns = (
        column("finding", [finding.title for finding in findings], "finding"),
        _paper(findings),
        *(_values(findings, item, entries) for item in items),
    )
    return Table("values", "Findings with each ingredient alone", columns)


def difference_table(findings: Sequence[Finding], items: Sequence[Ingredient], entries: Entries) -> Table:
    """Return a row for each finding, with its paired difference to one layer for each ingredient, and verdicts."""
    columns = [column("finding", [finding.title for finding in findings], "finding")]
    for item in items:
        if item.name != ONE_LAYER:
            found = [entries[finding.name, item.name] for finding in findings]
            cells = [f"{_signed(entry.difference, entry.difference_error)} {entry.verdict}".strip() for entry in found]
            columns.append(column(item.name, cells, item.title))
    return Table("differences", "Paired differences to one layer", tuple(columns))


def observation_table(item: Ingredient, values: Values) -> Table:
    """Return the values of the observations of one survey, for files."""
    columns = tuple(file_column(name, array, UNITS.get(name, "")) for name, array in values.items())
    return Table(f"observations_{item.name}", item.title, columns)


def ingredient_table(items: Sequence[Ingredient], options: Mapping[str, str]) -> Table:
    """Return a row for each ingredient, with its settings as options of a command and their origin."""
    columns = (
        column("ingredient", [item.title for item in items], "ingredient"),
        column("settings", [options[item.name] for item in items], "settings"),
        column("origin", [item.origin for item in items], "origin"),
    )
    return Table("ingredients", "Ingredients", columns)


def _paper(findings: Sequence[Finding]) -> Column:
    cells = tuple(_published(finding) for finding in findings)
    return Column("paper", np.array([finding.paper for finding in findings]), heading="paper", cells=cells)


def _published(finding: Finding) -> str:
    if not np.isfinite(finding.paper):
        return ""
    known = np.isfinite(finding.paper_error)
    return with_error(finding.paper, finding.paper_error) if known else short(finding.paper)


def _values(findings: Sequence[Finding], item: Ingredient, entries: Entries) -> Column:
    found = [entries[finding.name, item.name] for finding in findings]
    cells = tuple(with_error(entry.value, entry.error) for entry in found)
    return Column(item.name, np.array([entry.value for entry in found]), heading=item.title, cells=cells)


def _verdicts(findings: Sequence[Finding], items: Sequence[Ingredient], entries: Entries, verdict: str) -> Column:
    names = [
        ", ".join(item.title for item in items if entries[finding.name, item.name].verdict == verdict)
        for finding in findings
    ]
    return column(verdict, names, f"{verdict}")


def _signed(value: float, error: float) -> str:
    text = with_error(value, error)
    return f"+{text}" if value > 0 else text
