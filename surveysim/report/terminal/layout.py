"""Tables and lines on a terminal of any width, safe for any content."""

import os
import sys
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

from rich.cells import cell_len
from rich.console import Console
from rich.segment import Segment
from rich.table import Column, Table

from mapmaker.printable import printable

NARROWEST = 20
WIDEST = 10_000


class Terminal(Console):
    """A console that prints texts literally: nothing in them is markup or controls the terminal."""

    def __init__(self, columns: int = 120, **options: Any) -> None:
        # Off a terminal rich takes 80 columns, in which the tables would break.
        self.wraps = "stderr" in options or sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()
        width = None if self.wraps else columns
        super().__init__(width=width, markup=False, emoji=False, highlight=False, **options)

    def render(self, *arguments: Any, **options: Any) -> Iterable[Segment]:
        """Segments of text, printable; those that move the cursor are rich's own."""
        for segment in super().render(*arguments, **options):
            text, style, control = segment
            if control or text.isprintable():
                yield segment
            else:
                yield Segment("\n".join(map(printable, text.split("\n"))), style)

    def say(self, text: str) -> None:
        """Print lines, wrapped between words where they are wider than the terminal."""
        for line in text.split("\n"):
            line, room = printable(line), max(NARROWEST, self.width)
            if self.wraps:
                indent = line[: len(line) - len(line.lstrip())]
                line = textwrap.fill(
                    line, room, break_long_words=False, break_on_hyphens=False, subsequent_indent=indent
                )
            self.print(line, soft_wrap=True)

    def show(self, table: Table) -> None:
        """Print a table, or its rows one after the other, one line per cell, if it does not fit.

        Words are never broken, nor are cells of right-justified columns (numbers).
        """
        for column in table.columns:
            column.min_width = _narrowest(column)
        wide = self.measure(table, options=self.options.update(width=WIDEST))
        fits = wide.minimum <= self.width
        if fits and wide.maximum > self.width:
            _narrow(table.columns, self.width - wide.minimum)
        if table.title and (not fits or cell_len(str(table.title)) > self.measure(table).maximum):
            self.say(str(table.title))
            table.title = None
        if fits:
            self.print(table)
            return
        cells = [list(column.cells) for column in table.columns]
        for row in zip(*cells, strict=True):
            self.say("")
            for column, cell in zip(table.columns, row, strict=True):
                line = f"{column.header}: {cell}"
                whole = column.justify == "right" and cell_len(line) > self.width  # as a number is not broken
                if str(cell):
                    self.say(f"{column.header}:\n  {cell}" if whole else line)
        self.say("")


def _narrowest(column: Column) -> int:
    """Width that the longest word or number needs."""
    cells = [str(cell) for cell in column.cells]
    words = [word for text in (str(column.header), *cells) for word in text.split()]
    return max(map(cell_len, words + cells if column.justify == "right" else words), default=0)


def _narrow(columns: Sequence[Column], free: int) -> None:
    """Distribute the free width over the columns that need more than their narrowest width: rich would break words."""
    wanted = {id(column): _widest(column) - column.min_width for column in columns}
    for place, column in enumerate(sorted(columns, key=lambda column: wanted[id(column)])):
        more = min(wanted[id(column)], free // (len(columns) - place))
        column.width, free = column.min_width + more, free - more


def _widest(column: Column) -> int:
    lines = [line for text in (column.header, *column.cells) for line in str(text).split("\n")]
    return max(map(cell_len, lines))
