"""Cells and tables of a report page, from numbers and tables of results; the blocks are those of `mapmaker.report`."""

import math

from mapmaker.report.components import Block, Cell, Grid, Listing, Page, Picture, Section, Terms, Text, picture
from surveysim.runtime.numbers import count, with_error
from surveysim.runtime.table import Table

__all__ = [
    "UK2",
    "Block",
    "Cell",
    "Grid",
    "Listing",
    "Page",
    "Picture",
    "Section",
    "Terms",
    "Text",
    "cell",
    "grid",
    "measured",
    "picture",
]
UK2 = "µK²_CMB"


def cell(value: object) -> Cell:
    """Make a cell of a text or a count."""
    if isinstance(value, int) and not isinstance(value, bool):
        return Cell(count(value), value)
    return Cell(str(value))


def measured(value: float | None, error: float | None = None) -> Cell:
    """Make a cell of a number, rounded to two digits of its error or else to three digits; empty for none."""
    if value is None or not math.isfinite(value):
        return Cell("")
    return Cell(with_error(value, error), value)


def grid(table: Table, *notes: str) -> Grid:
    """Convert a table of results to a part of a page, with notes below."""
    shown = table.shown
    numbers = [column.array.tolist() if column.is_numeric else [None] * len(column.values) for column in shown]
    rows = tuple(
        tuple(Cell(text, _value(text, value)) for text, value in zip(texts, values, strict=True))
        for texts, values in zip(table.rows, zip(*numbers, strict=True), strict=True)
    )
    headings = tuple(column.heading for column in shown)
    return Grid(f"{table.name}-table", table.title, headings, rows, notes, table.best)


def _value(text: str, value: float | None) -> float | None:
    """Unrounded number of a cell; None for a text or a missing number."""
    return value if text and value is not None and math.isfinite(value) else None
