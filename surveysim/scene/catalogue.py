"""Catalogues of sources, in ECSV or FITS, and their error messages."""

import io
import os
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import decoded, one_line, read_bytes
from surveysim.scene.frequency_table import check_rows, column_numbers, ecsv_table

MAX_BYTES = 200_000_000  # some million sources
_FITS = b"SIMPLE  ="
REQUIRED = {"ra": "rad", "dec": "rad", "flux": "Jy"}
OPTIONAL = {"size": "rad", "spectral_index": ""}
_WIDEST_RAD = np.radians(30)


@dataclass(frozen=True, eq=False)
class Catalogue:
    """Sources of a catalogue.

    Attributes
    ----------
    ra_rad, dec_rad : (n,)
        Directions (J2000).
    flux_jy : (n,)
        Flux densities.
    fwhm_rad : (n,)
        Widths of Gaussian sources; 0 for points.
    spectral_index : (n,) or None
        Indices of the flux densities as powers of frequency; None without such a column.
    names : tuple of str
        Names; numbers of the rows, from 1, without such a column.
    """

    ra_rad: np.ndarray
    dec_rad: np.ndarray
    flux_jy: np.ndarray
    fwhm_rad: np.ndarray
    spectral_index: np.ndarray | None
    names: tuple[str, ...]

    def __len__(self) -> int:
        """Number of sources."""
        return len(self.ra_rad)


@lru_cache(maxsize=8)  # bands, and points of a sweep, have catalogues in common
def read_catalogue(path: Path) -> Catalogue:
    """Read a catalogue.

    Raises
    ------
    InputError
        For a file without the columns `ra`, `dec` and `flux`, other units, and values that are missing or out of range:
        one line with the file and the row (from 1) or column.
    """
    try:
        return _checked(_table(read_bytes(path, MAX_BYTES)))
    except InputError as error:
        missing = "" if os.path.lexists(path) else "no such file in the folder of the scene"
        raise InputError(
            f"catalogue_file: {path}: {missing or error}; a catalogue with ra, dec and flux is expected"
        ) from None


def _table(content: bytes) -> Any:
    if not content.startswith(_FITS):
        return ecsv_table(decoded(content).splitlines())
    from astropy.table import Table

    try:
        with warnings.catch_warnings(action="ignore"):
            table = Table.read(io.BytesIO(content), format="fits")
            table.convert_bytestring_to_unicode()
    except Exception as error:  # astropy raises many types of errors for broken files
        raise InputError(f"not a FITS file with a table ({one_line(error)})") from None
    return table


def _checked(table: Any) -> Catalogue:
    for name in REQUIRED:
        if name not in table.colnames:
            raise InputError(f"column {name!r}: missing")
    if not len(table):
        raise InputError("found no row")
    columns = {
        name: _column(table, name, unit) for name, unit in (REQUIRED | OPTIONAL).items() if name in table.colnames
    }
    degrees = {name: np.degrees(columns[name]) for name in ("ra", "dec")}
    check_rows("ra", degrees["ra"], np.abs(degrees["ra"]) <= 360, "-360 to 360 deg", unit=" deg")
    check_rows("dec", degrees["dec"], np.abs(degrees["dec"]) <= 90, "-90 to 90 deg", unit=" deg")
    check_rows("flux", columns["flux"], np.abs(columns["flux"]) <= 1e9, "up to 1e9 Jy", unit=" Jy")
    size, index = columns.get("size", np.zeros(len(table))), columns.get("spectral_index")
    check_rows("size", np.degrees(size) * 3600, (size >= 0) & (size <= _WIDEST_RAD), "0 to 30 deg", unit=" arcsec")
    if index is not None:
        check_rows("spectral_index", index, np.abs(index) <= 20, "-20 to 20")
    names = [str(name) for name in (table["name"] if "name" in table.colnames else range(1, 1 + len(table)))]
    return Catalogue(columns["ra"], columns["dec"], columns["flux"], size, index, tuple(names))


def _column(table: Any, name: str, unit: str) -> np.ndarray:
    column = table[name]
    if unit and column.unit is None:
        raise InputError(f"column {name!r}: found no unit, and one like {'deg' if unit == 'rad' else 'mJy'} is needed")
    return column_numbers(table, name, unit)
