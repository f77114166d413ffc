"""Tables of results, built once for files, terminals, pages and notebooks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from surveysim.runtime.numbers import plain, quoted

if TYPE_CHECKING:
    from astropy.table import QTable

SIGMA = "sigma(A) [uK_CMB^2]"  # heading of a column of scores


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Parameters
    ----------
    name : str
        Name in files.
    values : sequence
        Numbers, texts, or None where there is no value.
    unit : str
        Unit of the values, as astropy writes it.
    heading : str
        Name for people.
    cells : tuple of str, optional
        Values as people read them; None keeps the column to files.
    in_files : bool
        Whether files have the column.
    """

    name: str
    values: Sequence[Any] | np.ndarray
    unit: str = ""
    heading: str = ""
    cells: tuple[str, ...] | None = None
    in_files: bool = True

    @property
    def is_numeric(self) -> bool:
        """Return whether the column holds numbers."""
        return self.array.dtype.kind in "iuf"

    @property
    def array(self) -> np.ndarray:
        """Values as an array (n_row,), NaN where there is none."""
        if isinstance(self.values, np.ndarray):
            return self.values
        return np.array([np.nan if value is None else value for value in self.values])


@dataclass(frozen=True)
class Table:
    """A table of results.

    Parameters
    ----------
    name : str
        Name in files and anchors.
    title : str
        Title for people.
    columns : tuple of Column
        Columns of equal length, in order; the first names the rows.
    best : tuple of int
        Rows to point out.
    meta : mapping
        Header of files.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    best: tuple[int, ...] = ()
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def shown(self) -> tuple[Column, ...]:
        """Columns for people."""
        return tuple(item for item in self.columns if item.cells is not None)

    @property
    def rows(self) -> list[tuple[str, ...]]:
        """Cells of each row, as people read them."""
        return list(zip(*(item.cells for item in self.shown), strict=True))

    @property
    def in_files(self) -> dict[str, np.ndarray]:
        """Arrays (n_row,) of the columns in files, by name."""
        return {item.name: item.array for item in self.columns if item.in_files}

    @property
    def units(self) -> dict[str, str]:
        """Units of the columns in files that have one, by name."""
        return {item.name: item.unit for item in self.columns if item.in_files and item.unit}

    def quantities(self) -> "QTable":
        """Return the columns in files as an astropy table with units."""
        from astropy.table import QTable
        from astropy.units import Quantity

        made = QTable(meta=dict(self.meta))
        for name, values in self.in_files.items():
            unit = self.units.get(name)
            made[name] = Quantity(values, unit) if unit else values
        return made

    def text(self, most: int = 12) -> str:
        """Return the columns for people as lines of ASCII text, headings first, with `most` rows at most."""
        heads = tuple(item.heading for item in self.shown)
        rows = [tuple(map(plain, row)) for row in (heads, *self.rows[:most])]
        widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
        sides = [">" if item.is_numeric else "<" for item in self.shown]
        looks = [f"{{:{side}{width}}}" for side, width in zip(sides, widths, strict=True)]
        lines = ["  ".join(looks).format(*row).rstrip() for row in rows]
        rest = len(self.rows) - most
        return "\n".join([*lines, f"and {rest} more"] if rest > 0 else lines)

    def html(self) -> str:
        """Return the columns for people as an HTML table, for notebooks."""
        parts = [f"<table><caption>{escape(self.title)}</caption><thead><tr>"]
        parts += [f"<th>{escape(item.heading)}</th>" for item in self.shown]
        parts.append("</tr></thead><tbody>")
        for row in self.rows:
            parts.append(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>")
        return "".join([*parts, "</tbody></table>"])


def file_column(name: str, values: Sequence[Any] | np.ndarray, unit: str = "") -> Column:
    """Return a column that files alone have."""
    return Column(name, values, unit)


def column(
    name: str,
    values: Sequence[Any] | np.ndarray,
    heading: str,
    show: Callable[[Any], str] = str,
    *,
    unit: str = "",
    in_files: bool = True,
) -> Column:
    """Return a column whose values people read as `show` writes them, empty where there is none."""
    cells = tuple("" if value is None else show(value) for value in values)
    return Column(name, values, unit, heading, cells, in_files)


def quoted_columns(
    names: tuple[str, str],
    values: Sequence[float | None],
    errors: Sequence[float | None],
    heading: str,
    *,
    unit: str = "",
    absent: str = "",
    in_files: bool = True,
    digits: int = 0,
) -> tuple[Column, Column]:
    """Return two columns of values and their errors, which people read as one.

    Parameters
    ----------
    names : tuple of str
        Names of values and of errors in files.
    values, errors : sequence of float
        Values, None where there is none, and errors, None where unknown.
    heading : str
        Name for people.
    unit : str
        Unit of both.
    absent : str
        Text in place of a missing value.
    in_files : bool
        Whether files have the two.
    digits : int
        Least number of digits of a value, even where its error is larger.
    """
    pairs = zip(values, errors, strict=True)
    cells = tuple(absent if value is None else quoted(value, error, digits) for value, error in pairs)
    return (
        Column(names[0], values, unit, heading, cells, in_files),
        Column(names[1], errors, unit, in_files=in_files),
    )


def share_text(share: float) -> str:
    """``18.4 %``."""
    return f"{100 * share:.1f} %"
