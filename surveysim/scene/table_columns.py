"""Columns of a table of detectors: meaning, unit, range, and conversion to internal units."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.scene.fields import LONGEST_LINE, PSD_MAX_MK2_HZ
from surveysim.scene.units import shown

MAX_OFFSET_RAD = math.radians(15)  # from the boresight: the reach of a map
ARCSEC_RAD = math.radians(1 / 3600)


@dataclass(frozen=True)
class NumberColumn:
    """Column of numbers.

    Parameters
    ----------
    unit
        Internal unit; "" for plain numbers.
    like
        Example of a unit for messages.
    least, most
        Range in the internal unit.
    expected
        The range in words.
    """

    unit: str
    like: str
    least: float
    most: float
    expected: str

    def cell_error(self, cell: str) -> str:
        """Return the values expected in place of a cell of a text file; empty if the cell is a number."""
        try:
            float(cell if "_" not in cell and cell.isascii() else "no number")
        except ValueError:
            return "a number is expected"
        return ""

    def values(self, name: str, column: Any) -> np.ndarray:
        """Convert a column to float64 in the internal unit; raises InputError for other types and units."""
        _check_type(name, column, "iuf", "float64")
        return np.asarray(column, dtype=float) * self._factor(name, column.unit)

    def wrong(self, values: np.ndarray) -> np.ndarray:
        """Flag values out of range."""
        return ~((values >= self.least * (1 - 1e-12)) & (values <= self.most * (1 + 1e-12)))

    def _factor(self, name: str, unit: Any) -> float:
        if unit is None:
            if not self.unit:
                return 1.0
            raise InputError(f"column {name!r}: found no unit; {self.like} is expected in the header")
        try:
            return float(unit.to(self.unit))
        except Exception:  # units of another kind, or unknown to astropy
            raise InputError(f"column {name!r}: found the unit {shown(str(unit))}; {self.like} is expected") from None


@dataclass(frozen=True)
class TextColumn:
    """Column of names."""

    expected: str = f"one line of up to {LONGEST_LINE} characters is expected"

    def cell_error(self, cell: str) -> str:
        """Return the values expected in place of a cell of a text file; empty for a name."""
        return "" if cell else "a name is expected"

    def values(self, name: str, column: Any) -> np.ndarray:
        """Convert a column of names or whole numbers to text; raises InputError for other types."""
        _check_type(name, column, "USiu", "string")
        return np.asarray(column).astype(str)

    def wrong(self, values: np.ndarray) -> np.ndarray:
        """Flag empty names, long ones, and those with control characters."""
        return np.array([not (0 < len(text) <= LONGEST_LINE and text.isprintable()) for text in values.tolist()])


@dataclass(frozen=True)
class FlagColumn:
    """Column of true and false, or 1 and 0."""

    expected: str = "True or False, or 1 or 0, is expected"

    def cell_error(self, cell: str) -> str:
        """Return the values expected in place of a cell of a text file; empty for a flag."""
        return "" if cell.lower() in ("true", "false", "0", "1") else self.expected

    def values(self, name: str, column: Any) -> np.ndarray:
        """Convert a column to integers; raises InputError for other types."""
        _check_type(name, column, "biu", "bool")
        return np.asarray(column).astype(int)

    def wrong(self, values: np.ndarray) -> np.ndarray:
        """Flag values other than 0 and 1."""
        return (values != 0) & (values != 1)


Column = NumberColumn | TextColumn | FlagColumn
_OFFSET = NumberColumn(
    "rad",
    "an angular one like arcsec",
    -MAX_OFFSET_RAD,
    MAX_OFFSET_RAD,
    f"a finite offset from the boresight of up to {math.degrees(MAX_OFFSET_RAD):g} deg is expected",
)


def _ratio(of: str) -> NumberColumn:
    return NumberColumn("", "no unit or a ratio like %", 1e-3, 1e3, f"a {of} from 0.001 to 1000 is expected")


COLUMNS: dict[str, Column] = {
    "x": _OFFSET,
    "y": _OFFSET,
    "name": TextColumn(),
    "band": TextColumn(),
    "dead": FlagColumn(),
    "nep": NumberColumn(
        "W / Hz(1/2)", "one like W / Hz(1/2)", 1e-30, 1e-6, "an NEP from 1e-30 to 1e-6 W / Hz(1/2) is expected"
    ),
    "psd": NumberColumn(
        "mK2 / Hz",
        "one like mK2 / Hz",
        1e-12,
        PSD_MAX_MK2_HZ,
        f"a PSD from 1e-12 to {PSD_MAX_MK2_HZ:g} mK2 / Hz is expected",
    ),
    "responsivity": _ratio("responsivity"),
    "beam_fwhm": NumberColumn(
        "rad",
        "an angular one like arcsec",
        0.001 * ARCSEC_RAD,
        math.radians(30),
        "a beam from 0.001 arcsec to 30 deg is expected",
    ),
    "efficiency": _ratio("relative efficiency"),
    "angle": NumberColumn(
        "rad",
        "an angular one like deg",
        -2 * math.pi,
        2 * math.pi,
        "a polarization angle from -360 to 360 deg is expected",
    ),
    "time_constant": NumberColumn(
        "s", "one of time like ms", 0.0, 100.0, "a time constant from 0 to 100 s is expected"
    ),
    "readout_group": TextColumn(),
}
REQUIRED = ("x", "y")


def _check_type(name: str, column: Any, kinds: str, expected: str) -> None:
    kind = getattr(getattr(column, "dtype", None), "kind", "")
    if kind not in tuple(kinds) or getattr(column, "ndim", 0) != 1:
        raise InputError(f"column {name!r}: found datatype {getattr(column, 'dtype', '?')}; {expected} is expected")
