"""Tables of detector positions: ECSV files with columns x and y, and their error messages."""

import csv
import math
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import one_line, read_text
from surveysim.scene.units import shown

KEY = "instrument.positions"
COLUMNS = ("x", "y")
MAX_BYTES = 10_000_000  # some 200,000 detectors
MAX_OFFSET_RAD = math.radians(15)  # from the boresight: the reach of a map
_COMMAS = re.compile(r"""\s*#\s*delimiter:\s*(['"]),\1\s*(\s#.*)?""")


def read_positions(path: Path) -> np.ndarray:
    """Read detector positions (n_det, 2) [rad] from an ECSV table with columns x and y in angular units.

    Raises
    ------
    InputError
        For other columns, cells that are not finite numbers, offsets beyond 15 degrees, and two detectors at the same
        position; one line with the file and the row (from 1) or column.
    """
    try:
        text = read_text(path, MAX_BYTES)
    except InputError as error:
        raise InputError(f"{KEY}: {path}: {_missing(path) or error}; an ECSV table is expected") from None
    try:
        return _positions(text)
    except InputError as error:
        raise InputError(f"{KEY}: {path}: {error}") from None


def _missing(path: Path) -> str:
    return "" if os.path.lexists(path) else "no such file in the folder of the scene"


def _positions(text: str) -> np.ndarray:
    table = _table(text.splitlines())
    columns = [_column(table, name) for name in COLUMNS]
    if not len(table):
        raise InputError("found no row; one row for each detector is expected")
    positions = np.column_stack(columns)
    wrong = np.argwhere(~np.isfinite(positions) | (np.abs(positions) > MAX_OFFSET_RAD))
    if len(wrong):
        row, column = wrong[0]
        found = f"{table[COLUMNS[column]][row]} {table[COLUMNS[column]].unit}"
        raise InputError(
            f"row {row + 1}, column {COLUMNS[column]!r}: found {shown(found)}; a finite offset from the boresight of up"
            f" to {math.degrees(MAX_OFFSET_RAD):g} deg is expected"
        )
    _, first, where = np.unique(positions, axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[where.ravel()] != np.arange(len(positions)))
    if len(again):
        raise InputError(
            f"row {again[0] + 1}: found the position of row {first[where.ravel()[again[0]]] + 1}; different positions"
            " are expected"
        )
    return positions


def _table(lines: list[str]) -> Any:
    """Parse the lines of an ECSV file and check its columns."""
    from astropy.table import Table

    if not lines or not lines[0].startswith("# %ECSV"):
        found = shown(lines[0]) if lines else "an empty file"
        raise InputError(f"found {found}; '# %ECSV 1.0' is expected in the first line")
    _check_cells(lines)
    try:
        with warnings.catch_warnings(action="ignore"):  # warnings about data types, which are checked here
            table = Table.read(lines, format="ascii.ecsv")
    except Exception as error:  # astropy and yaml raise many types of errors for broken tables
        reason = one_line(error) or type(error).__name__
        raise InputError(f"not an ECSV table with columns x and y in angular units ({reason})") from None
    return table


def _check_cells(lines: list[str]) -> None:
    """Raise InputError for columns other than x and y, and for rows that are not two numbers, naming the row."""
    delimiter = "," if any(map(_COMMAS.fullmatch, lines)) else " "
    stripped = (line.strip() for line in lines)
    rows = csv.reader(
        (line for line in stripped if line and not line.startswith("#")), delimiter=delimiter, skipinitialspace=True
    )
    names: list[str] | None = None
    try:
        for number, cells in enumerate(rows):
            if names is None:
                names = cells
                _check_names(names)
                continue
            if len(cells) != len(names):
                raise InputError(
                    f"row {number}: found {len(cells)} cells, {shown(delimiter.join(cells))}; {len(names)} are expected"
                )
            for name, cell in zip(names, cells, strict=True):
                _check_number(number, name, cell)
    except csv.Error as error:
        raise InputError(f"not a table of cells ({one_line(error)})") from None
    if names is None:
        raise InputError("found no row of column names; the names x and y and a row for each detector are expected")


def _check_names(names: list[str]) -> None:
    other = [name for name in names if name not in COLUMNS]
    if other:
        raise InputError(
            f"column {shown(other[0])}: unknown; only the columns x and y are allowed; leave out rows of detectors"
            " that do not work"
        )
    for name in COLUMNS:
        if names.count(name) != 1:
            found = "missing" if name not in names else "found more than once"
            raise InputError(f"column {name!r}: {found}; the columns x and y, each once, are expected")


def _check_number(row: int, name: str, cell: str) -> None:
    try:
        float(cell if "_" not in cell and cell.isascii() else "no number")
    except ValueError:
        found = shown(cell) if cell else "an empty cell"
        raise InputError(f"row {row}, column {name!r}: found {found}; a number is expected") from None


def _column(table: Any, name: str) -> np.ndarray:
    """One column in radians; raises InputError for a wrong type or unit, and masked cells."""
    if name not in table.colnames:
        raise InputError(f"column {name!r}: missing in the header; the columns x and y are expected")
    column = table[name]
    kind = getattr(getattr(column, "dtype", None), "kind", "")
    if kind not in "iuf" or getattr(column, "ndim", 0) != 1:
        raise InputError(f"column {name!r}: found datatype {getattr(column, 'dtype', '?')}; float64 is expected")
    if column.unit is None:
        raise InputError(f"column {name!r}: found no unit; an angular one like arcsec is expected in the header")
    masked = np.flatnonzero(np.broadcast_to(getattr(column, "mask", False), len(column)))
    if len(masked):
        raise InputError(f"row {masked[0] + 1}, column {name!r}: found an empty cell; a number is expected")
    try:
        factor = float(column.unit.to("rad"))
    except Exception:  # units that are no angle, or unknown to astropy
        raise InputError(
            f"column {name!r}: found the unit {shown(str(column.unit))}; one of angle like arcsec is expected"
        ) from None
    return np.asarray(column, dtype=float) * factor
