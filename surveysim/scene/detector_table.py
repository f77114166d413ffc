"""Tables of detectors, in ECSV or FITS: positions and properties of each, and the error messages of their files."""

import csv
import io
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import decoded, one_line, read_bytes
from surveysim.scene.similar_names import did_you_mean
from surveysim.scene.table_columns import COLUMNS, REQUIRED
from surveysim.scene.units import shown

KEY = "instrument.positions"
MAX_BYTES = 10_000_000  # some 100,000 detectors
_FITS = b"SIMPLE  ="
_COMMAS = re.compile(r"""\s*#\s*delimiter:\s*(['"]),\1\s*(\s#.*)?""")
_ALL = ", ".join(COLUMNS)


@dataclass(frozen=True, eq=False)
class DetectorTable:
    """Table of detectors, a row for each.

    Attributes
    ----------
    columns
        Values (n_row,) of each column of the file by name: numbers in internal units, texts, and `dead` as bool. The
        properties of dead detectors have no meaning.
    """

    columns: Mapping[str, np.ndarray]

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.columns["x"])

    @property
    def positions_rad(self) -> np.ndarray:
        """Offsets (n_row, 2) from the boresight."""
        return np.column_stack([self.columns["x"], self.columns["y"]])

    @property
    def live(self) -> np.ndarray:
        """Flags (n_row,) of the detectors that work."""
        return ~self.columns["dead"] if "dead" in self.columns else np.ones(len(self), bool)

    def band_rows(self, band: str | None) -> np.ndarray:
        """Flags (n_row,) of the detectors of a band, dead ones included; all of a table of one band without a choice.

        Raises
        ------
        InputError
            For a band that the table lacks, or has no live detector of, and for several bands without a choice.
        """
        names = self.columns.get("band")
        if names is None:
            if band is not None:
                raise InputError(f"instrument.band: found {band!r}, and a table of detectors without a column 'band'")
            return np.ones(len(self), bool)
        live = list(dict.fromkeys(names[self.live].tolist()))
        there = ", ".join(map(repr, live))
        if band is None and len(live) > 1:
            raise InputError(
                f"instrument.band: missing; the table of detectors has several: one of {there} is expected"
            )
        if band is not None and band not in live:
            raise InputError(f"instrument.band: found {band!r}; one of {there} is expected")
        return np.ones(len(self), bool) if band is None else names == band

    def noise(self, band: str | None) -> tuple[str, float] | None:
        """Noise of the live detectors of a band: "nep" and its root mean square [W/sqrt(Hz)], or "psd" and its mean
        [mK^2/Hz]; None without such a column.
        """
        name = next((name for name in ("nep", "psd") if name in self.columns), None)
        if name is None:
            return None
        values = self.columns[name][self.band_rows(band) & self.live]
        return name, float(np.sqrt(np.mean(values**2)) if name == "nep" else np.mean(values))


@lru_cache(maxsize=8)  # the bands of a camera, and the points of a sweep, have a table in common
def detector_table(path: Path) -> DetectorTable:
    """Read a table of detectors once; as `read_detectors`."""
    return read_detectors(path)


def read_detectors(path: Path) -> DetectorTable:
    """Read a table of detectors, ECSV or FITS.

    The columns and their ranges are `surveysim.scene.table_columns.COLUMNS`; `x` and `y` are required.

    Raises
    ------
    InputError
        For unknown columns, wrong types or units, values out of range, empty cells, names that are used twice, and two
        detectors of a band at the same position and polarization angle; one line with the file and the row (from 1) or
        column. Cells of dead detectors can be empty or NaN, but for their position.
    """
    try:
        content = read_bytes(path, MAX_BYTES)
        text = "" if content.startswith(_FITS) else decoded(content)
    except InputError as error:
        raise InputError(f"{KEY}: {path}: {_missing(path) or error}; an ECSV or FITS table is expected") from None
    try:
        found = _fits_table(content) if content.startswith(_FITS) else _ecsv_table(text.splitlines())
        return _checked(found)
    except InputError as error:
        raise InputError(f"{KEY}: {path}: {error}") from None


def _missing(path: Path) -> str:
    return "" if os.path.lexists(path) else "no such file in the folder of the scene"


# ---------------------------------------------------------------- columns


def _checked(table: Any) -> DetectorTable:
    """Convert and check all columns of a table of astropy."""
    _check_names(table.colnames)
    columns = {name: COLUMNS[name].values(name, table[name]) for name in table.colnames}
    if not len(table):
        raise InputError("found no row; one row for each detector is expected")
    if "dead" in columns:
        _check_column(table, "dead", columns["dead"], np.ones(len(table), bool))
        columns["dead"] = columns["dead"] == 1
    found = DetectorTable(columns)
    for name, values in columns.items():
        if name != "dead":
            _check_column(table, name, values, np.ones(len(table), bool) if name in REQUIRED else found.live)
    if not found.live.any():
        raise InputError(f"column 'dead': found all {len(found)} detectors dead; a live one is expected")
    _check_twice(found)
    return found


def _check_names(names: Sequence[str]) -> None:
    for name in names:
        if name not in COLUMNS:
            raise InputError(
                f"column {shown(name)}: unknown; {did_you_mean(name, COLUMNS) or f'the columns {_ALL} are allowed'}"
            )
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"column {name!r}: found more than once; each column once is expected")
    for name in REQUIRED:
        if name not in names:
            raise InputError(f"column {name!r}: missing; the columns x and y, each once, are expected")
    if "nep" in names and "psd" in names:
        raise InputError("column 'psd': found together with 'nep'; one of the two is expected")


def _check_column(table: Any, name: str, values: np.ndarray, rows: np.ndarray) -> None:
    """Raise InputError for empty cells and values out of range in the flagged rows."""
    rule, column = COLUMNS[name], table[name]
    masked = np.flatnonzero(np.broadcast_to(getattr(column, "mask", False), len(column)) & rows)
    if len(masked):
        raise InputError(f"row {masked[0] + 1}, column {name!r}: found an empty cell; a value is expected")
    wrong = np.flatnonzero(rule.wrong(values) & rows)
    if len(wrong):
        found = f"{column[wrong[0]]} {column.unit or ''}".strip()
        raise InputError(f"row {wrong[0] + 1}, column {name!r}: found {shown(found)}; {rule.expected}")


def _check_twice(table: DetectorTable) -> None:
    """Raise InputError for two detectors of one name, or of one position, band and polarization angle."""
    columns = table.columns
    if "name" in columns and (pair := _first_pair(columns["name"])):
        raise InputError(f"row {pair[1] + 1}, column 'name': found the name of row {pair[0] + 1}; another is expected")
    parts = [columns[name] for name in ("x", "y", "band", "angle") if name in columns]
    _, codes = zip(*(np.unique(part, return_inverse=True) for part in parts), strict=True)
    if pair := _first_pair(np.column_stack([code.ravel() for code in codes])):
        raise InputError(
            f"row {pair[1] + 1}: found the position of row {pair[0] + 1}; different positions, bands or polarization"
            " angles are expected"
        )


def _first_pair(values: np.ndarray) -> tuple[int, int] | None:
    """Find the first row whose values an earlier row has, and that row."""
    _, first, where = np.unique(values, axis=0, return_index=True, return_inverse=True)
    again = np.flatnonzero(first[where.ravel()] != np.arange(len(values)))
    return (int(first[where.ravel()[again[0]]]), int(again[0])) if len(again) else None


# ---------------------------------------------------------------- files


def _fits_table(content: bytes) -> Any:
    """Read the first table of a FITS file."""
    from astropy.table import Table

    try:
        with warnings.catch_warnings(action="ignore"):
            # NaN stays NaN, as in a text file; only a mask marks an empty cell.
            table = Table.read(io.BytesIO(content), format="fits", mask_invalid=False)
            table.convert_bytestring_to_unicode()
    except Exception as error:  # astropy raises many types of errors for broken files
        raise InputError(f"not a FITS file with a table ({one_line(error)})") from None
    return table


def _ecsv_table(lines: list[str]) -> Any:
    """Parse the lines of an ECSV file, after a check of its cells."""
    from astropy.table import Table

    if not lines or not lines[0].startswith("# %ECSV"):
        found = shown(lines[0]) if lines else "an empty file"
        raise InputError(f"found {found}; '# %ECSV 1.0' is expected in the first line, or a FITS table")
    _check_cells(lines)
    try:
        with warnings.catch_warnings(action="ignore"):  # warnings about data types, which are checked here
            table = Table.read(lines, format="ascii.ecsv")
    except Exception as error:  # astropy and yaml raise many types of errors for broken tables
        reason = one_line(error) or type(error).__name__
        raise InputError(f"not an ECSV table with columns x and y in angular units ({reason})") from None
    return table


def _check_cells(lines: list[str]) -> None:
    """Raise InputError for unknown columns and for rows whose cells do not fit them, naming the row."""
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
            _check_row(number, dict(zip(names, cells, strict=True)))
    except csv.Error as error:
        raise InputError(f"not a table of cells ({one_line(error)})") from None
    if names is None:
        raise InputError("found no row of column names; the names x and y and a row for each detector are expected")


def _check_row(number: int, cells: Mapping[str, str]) -> None:
    dead = cells.get("dead", "").lower() in ("true", "1")
    for name, cell in cells.items():
        left_empty = dead and not cell and name not in REQUIRED
        if not left_empty and (expected := COLUMNS[name].cell_error(cell)):
            found = shown(cell) if cell else "an empty cell"
            raise InputError(f"row {number}, column {name!r}: found {found}; {expected}")
