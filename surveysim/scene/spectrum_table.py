"""Tables of an angular power spectrum (ECSV), and their error messages."""

import os
from functools import lru_cache
from pathlib import Path

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import read_text
from surveysim.scene.frequency_table import MAX_BYTES, check_rows, column_numbers, ecsv_table
from surveysim.scene.units import shown


@lru_cache(maxsize=8)
def read_spectrum(key: str, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the columns `ell` and `cl` of an ECSV table.

    Parameters
    ----------
    key
        Key of the scene that names the file, for messages.

    Returns
    -------
    ell : (n,)
        Multipoles, increasing.
    power : (n,)
        Band powers ``ell (ell + 1) C_ell / 2 pi`` [uK_CMB^2].

    Raises
    ------
    InputError
        For other columns, fewer than two rows, multipoles that do not increase from above 0, and negative values: one
        line with the key, the file and the row (from 1) or column.
    """
    try:
        ell, cl = spectrum_columns(read_text(path, MAX_BYTES).splitlines())
    except InputError as error:
        missing = "" if os.path.lexists(path) else "no such file in the folder of the scene"
        raise InputError(f"{key}: {path}: {missing or error}; a table of ell and cl is expected") from None
    return ell, ell * (ell + 1) * cl / (2 * np.pi)


def spectrum_columns(lines: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Return ell and C_ell [uK2] of the lines of an ECSV table; raises InputError without the name of the file."""
    table = ecsv_table(lines)
    if set(table.colnames) != {"ell", "cl"}:
        raise InputError(f"found the columns {shown(', '.join(table.colnames))}")
    ell, cl = column_numbers(table, "ell", ""), column_numbers(table, "cl", "uK2")
    if len(ell) < 2:
        raise InputError(f"found {len(ell)} rows, and two or more are needed")
    check_rows("ell", ell, np.diff(ell, prepend=0.0) > 0, "more than 0 and than in the row before")
    check_rows("cl", cl, (cl >= 0) & np.isfinite(cl), "0 or more", unit=" uK2")
    return ell, cl
