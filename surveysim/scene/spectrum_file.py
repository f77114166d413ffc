"""Files of the spectrum of a Gaussian sky: those that CAMB and CLASS write, two columns, or ECSV."""

import os
import re
from functools import lru_cache
from pathlib import Path
from typing import Literal

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import read_text
from surveysim.scene.frequency_table import MAX_BYTES, check_rows
from surveysim.scene.spectrum_table import spectrum_columns
from surveysim.scene.units import CMB_TEMPERATURE_K, shown

SpectrumKind = Literal["camb", "class", "two_columns"]
EXPECTED = "a table of CAMB or CLASS, of two columns, or of ell and cl in ECSV, is expected"
# Headers that CAMB 1 and CLASS 2 and 3 write: "#    L    TT   EE ..." and "#   1:l     2:TT ...", or "#  l TT ...".
_CAMB = re.compile(r"#\s*L\s+TT\b")
_CLASS = re.compile(r"#\s*(1:)?l\s+(2:)?TT\b")
_SMALLEST = 1e-6  # largest band power [uK2] of a table that is in uK2 indeed


@lru_cache(maxsize=8)
def read_spectrum_file(path: Path, kind: SpectrumKind | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Read the spectrum of the temperature.

    Files of CAMB have band powers in uK2. Those of CLASS have them over the squared temperature of the CMB, or in uK2
    where their header says so. Two columns are l and the band power in uK2.

    Parameters
    ----------
    kind
        Columns of a text file; by default those that its header tells.

    Returns
    -------
    ell : (n,)
        Multipoles, increasing.
    power : (n,)
        Band powers ``l (l + 1) C_l / 2 pi`` [uK_CMB^2].

    Raises
    ------
    InputError
        For columns that are not known, fewer than two rows, multipoles that do not increase, values that are negative,
        and those that have no unit: one line with the file and the row (from 1).
    """
    try:
        lines = read_text(path, MAX_BYTES).splitlines()
        if lines and lines[0].startswith("# %ECSV"):
            ell, cl = spectrum_columns(lines)
            return ell, ell * (ell + 1) * cl / (2 * np.pi)
        return _band_powers(lines, kind)
    except InputError as error:
        missing = "" if os.path.lexists(path) else "no such file in the folder of the scene"
        raise InputError(f"spectrum: {path}: {missing or error}; {EXPECTED}") from None


def _band_powers(lines: list[str], kind: SpectrumKind | None) -> tuple[np.ndarray, np.ndarray]:
    header = [line for line in lines if line.lstrip().startswith("#")]
    rows = _rows([line for line in lines if line.strip() and not line.lstrip().startswith("#")])
    kind = kind or _kind(header, rows.shape[1])
    ell, power = rows[:, 0], rows[:, 1].copy()
    check_rows("l", ell, np.diff(ell, prepend=-1.0) > 0, "0 or more, and more than in the row before")
    check_rows("TT", power, (power >= 0) & np.isfinite(power), "0 or more")
    ell, power = ell[ell > 0], power[ell > 0]
    if kind == "class" and not any("microK" in line for line in header):
        power *= (1e6 * CMB_TEMPERATURE_K) ** 2
    if not power.max(initial=0.0) > _SMALLEST:
        raise InputError(f"found at most {power.max(initial=0.0):.3g} uK2, which is the size of numbers without unit")
    return ell, power


def _kind(header: list[str], n_column: int) -> SpectrumKind:
    if any(map(_CAMB.match, header)):
        return "camb"
    if any(map(_CLASS.match, header)):
        return "class"
    if n_column == 2:
        _check_two_columns(header)
        return "two_columns"
    raise InputError(f"found {n_column} columns without a header of CAMB or CLASS, and no 'spectrum_kind'")


def _check_two_columns(header: list[str]) -> None:
    """Raise InputError for a header of C_l itself, without a factor l (l + 1)."""
    text = re.sub(r"[\s*]", "", " ".join(header)).lower()
    if re.search(r"c_?\{?(l|ell)\b", " ".join(header).lower()) and not re.search(r"(l|ell)\+1", text):
        raise InputError("found a header of C_l; l (l + 1) C_l / 2 pi in uK2 is needed, or C_l in ECSV")


def _rows(lines: list[str]) -> np.ndarray:
    if len(lines) < 2:
        raise InputError(f"found {len(lines)} rows, and two or more are needed")
    n_column = len(lines[0].split())
    if n_column < 2:
        raise InputError(f"row 1: found {shown(lines[0])}, and two or more columns are needed")
    found = np.empty((len(lines), n_column))
    for number, line in enumerate(lines):
        cells = line.split()
        if len(cells) != n_column:
            raise InputError(f"row {number + 1}: found {len(cells)} columns, and {n_column} in the row before")
        try:
            found[number] = [float(cell.replace("D", "E")) for cell in cells]
        except ValueError:
            raise InputError(f"row {number + 1}: found {shown(line)}, and numbers are needed") from None
    return found
