"""Tables of a quantity against frequency (ECSV), and their error messages."""

import os
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import one_line, read_text
from surveysim.scene.units import shown

MAX_BYTES = 5_000_000
LOWEST_HZ, HIGHEST_HZ = 1e8, 1e14


def read_frequency_table(key: str, path: Path, name: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Read the columns `frequency` [Hz] and `name`, a number from 0 to 1, of an ECSV table.

    Parameters
    ----------
    key
        Key of the scene that names the file, for messages.

    Raises
    ------
    InputError
        For other columns, fewer than two rows, frequencies that do not increase, and values that are not numbers from
        0 to 1: one line with the key, the file and the row (from 1) or column.
    """
    try:
        frequency, value = _columns(read_text(path, MAX_BYTES).splitlines(), name)
    except InputError as error:
        missing = "" if os.path.lexists(path) else "no such file in the folder of the scene"
        raise InputError(f"{key}: {path}: {missing or error}; a table of frequency and {name} is expected") from None
    return tuple(frequency.tolist()), tuple(value.tolist())


def _columns(lines: list[str], name: str) -> tuple[np.ndarray, np.ndarray]:
    table = ecsv_table(lines)
    if set(table.colnames) != {"frequency", name}:
        raise InputError(f"found the columns {shown(', '.join(table.colnames))}")
    frequency, value = column_numbers(table, "frequency", "Hz"), column_numbers(table, name, "")
    if len(frequency) < 2:
        raise InputError(f"found {len(frequency)} rows, and two or more are needed")
    known = (frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)
    check_rows("frequency", frequency / 1e9, known, "0.1 GHz to 100 THz", unit=" GHz")
    increases = np.append(True, np.diff(frequency) > 0)
    check_rows("frequency", frequency / 1e9, increases, "more than in the row before", unit=" GHz")
    check_rows(name, value, (value >= 0) & (value <= 1), "0 to 1")
    return frequency, value


def ecsv_table(lines: list[str]) -> Any:
    """Parse the lines of an ECSV file; raises InputError without the name of the file."""
    from astropy.table import Table

    if not lines or not lines[0].startswith("# %ECSV"):
        raise InputError(f"found {shown(lines[0]) if lines else 'an empty file'} instead of '# %ECSV 1.0'")
    try:
        with warnings.catch_warnings(action="ignore"):  # about data types, which are checked here
            return Table.read(lines, format="ascii.ecsv")
    except Exception as error:  # astropy and yaml raise many types of errors for broken tables
        raise InputError(f"not an ECSV table ({one_line(error) or type(error).__name__})") from None


def column_numbers(table: Any, name: str, unit: str) -> np.ndarray:
    """Return one column in a unit ("" for none), with NaN in empty cells; errors as `ecsv_table`."""
    column = table[name]
    if column.dtype.kind not in "iuf" or column.ndim != 1:
        raise InputError(f"column {name!r}: found datatype {column.dtype} instead of float64")
    if unit and column.unit is None:
        raise InputError(f"column {name!r}: found no unit, and one like GHz belongs in the header")
    try:
        factor = float(column.unit.to(unit)) if column.unit is not None else 1.0
    except Exception:  # another kind of unit, or one unknown to astropy
        raise InputError(f"column {name!r}: found the unit {shown(str(column.unit))}") from None
    values = np.ma.filled(np.ma.asarray(column.data, dtype=float), np.nan) if hasattr(column, "mask") else column.data
    return np.asarray(values, dtype=float) * factor


def check_rows(name: str, values: np.ndarray, allowed: np.ndarray, expected: str, *, unit: str = "") -> None:
    """Raise InputError for the first row whose value is not allowed."""
    wrong = np.flatnonzero(~allowed)
    if len(wrong):
        found = f"{values[wrong[0]]:g}{unit}"
        raise InputError(f"row {wrong[0] + 1}, column {name!r}: found {found}, and {expected} is allowed")
