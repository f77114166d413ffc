"""Tables of a pixel's beam over the plane of the stop (ECSV), and their error messages."""

import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import read_text
from surveysim.scene.frequency_table import MAX_BYTES, check_rows, column_numbers, ecsv_table
from surveysim.scene.units import shown

KEY = "instrument.illumination"
LARGEST_RHO = 1000.0


class IlluminationTable(NamedTuple):
    """Radii over the radius of the stop, and intensities (`power` of 1) or amplitudes (`power` of 2) at them."""

    rho: tuple[float, ...]
    values: tuple[float, ...]
    power: int


def read_illumination(path: Path) -> IlluminationTable:
    """Read the columns `rho` and `intensity` or `amplitude` of an ECSV table.

    Raises
    ------
    InputError
        For other columns, fewer than two rows, radii that do not increase from 0 to 1 or more, values that are negative
        or not finite, and a beam without power: one line with the key, the file and the row (from 1) or column.
    """
    try:
        return _columns(read_text(path, MAX_BYTES).splitlines())
    except InputError as error:
        missing = "" if os.path.lexists(path) else "no such file in the folder of the scene"
        raise InputError(
            f"{KEY}: {path}: {missing or error}; a table of rho and intensity or amplitude is expected"
        ) from None


def _columns(lines: list[str]) -> IlluminationTable:
    table = ecsv_table(lines)
    names = sorted(table.colnames)
    if names not in (["intensity", "rho"], ["amplitude", "rho"]):
        raise InputError(f"found the columns {shown(', '.join(table.colnames))}")
    name = names[0]
    rho, values = column_numbers(table, "rho", ""), column_numbers(table, name, "")
    if len(rho) < 2:
        raise InputError(f"found {len(rho)} rows, and two or more are needed")
    check_rows("rho", rho, (rho >= 0) & (rho <= LARGEST_RHO), f"0 to {LARGEST_RHO:g}")
    check_rows(
        "rho", rho, np.append(rho[0] == 0, np.diff(rho) > 0), "0 in the first row, then more than in the row before"
    )
    check_rows(name, values, (values >= 0) & (values <= 1e6), "0 to 1e6")
    if rho[-1] < 1:
        raise InputError(f"column 'rho': found values up to {rho[-1]:g}, and the edge of the stop is 1")
    if not values[rho < 1].max() > 0:
        raise InputError(f"column {name!r}: found 0 in all rows within the stop, and one above 0 is needed")
    return IlluminationTable(tuple(rho.tolist()), tuple(values.tolist()), 1 if name == "intensity" else 2)
