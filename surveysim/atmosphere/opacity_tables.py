"""Tables of zenith optical depth by frequency and water vapour: of all heights, of a site, or of the user."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from surveysim.atmosphere.standard_air import air_temperature_k, temperature_offset_k, vapour_temperature_k
from surveysim.runtime.errors import InputError, OutOfRangeError
from surveysim.runtime.text_files import read_text
from surveysim.scene.place import Place
from surveysim.scene.units import shown

# Axes of the table of all heights (n_height, n_offset, n_cell, n_pwv).
HEIGHTS_TABLE = "opacity_heights.npy"
HEIGHTS_M = np.arange(0.0, 6001.0, 1000.0)
OFFSETS_K = np.array([-60.0, -35.0, -10.0, 15.0])
PWV_MM = 0.03 * (60 / 0.03) ** (np.arange(17) / 16)
EDGES_GHZ = np.arange(10.0, 1001.0)
MAX_BYTES = 20_000_000
_COLUMN = re.compile(r"pwv_(\d+\.?\d*(?:e-?\d+)?)", re.ASCII)


@dataclass(frozen=True)
class OpacityTable:
    """Zenith optical depth of cells of frequency.

    Attributes
    ----------
    edge_hz : (n_cell + 1,)
        Edges of the cells.
    pwv_mm : (n_pwv,)
        Columns of precipitable water vapour.
    optical_depth : (n_cell, n_pwv)
        -ln of the mean transmission of each cell.
    temperature_k
        Emission temperature of the water vapour.
    """

    edge_hz: np.ndarray
    pwv_mm: np.ndarray
    optical_depth: np.ndarray
    temperature_k: float


@cache
def opacity_table(place: Place) -> OpacityTable:
    """Return the table of a place: its own if it has one, else that of its height and temperature.

    Raises
    ------
    OutOfRangeError
        For a height or temperature outside the table of all heights.
    InputError
        For a file that is no such table: one line with the file and the row or column.
    """
    if place.opacity is None:
        return _at_height(place.height_m, place.temperature_k)
    try:
        return _own_table(read_text(place.opacity, MAX_BYTES).splitlines())
    except InputError as error:
        raise InputError(f"{place.opacity}: {error}; a table of frequency and optical depth is expected") from None


def _at_height(height_m: float, temperature_k: float) -> OpacityTable:
    if not HEIGHTS_M[0] <= height_m <= HEIGHTS_M[-1]:
        raise OutOfRangeError(
            f"found a height of {height_m:g} m; {HEIGHTS_M[0]:g} to {HEIGHTS_M[-1]:g} m is allowed, or a table of your"
            " own, site.opacity"
        )
    offset_k = temperature_offset_k(height_m, temperature_k)
    if not OFFSETS_K[0] <= offset_k <= OFFSETS_K[-1]:
        low, high = air_temperature_k(height_m, 0.0) + OFFSETS_K[[0, -1]]
        raise OutOfRangeError(
            f"found {temperature_k:g} K at a height of {height_m:g} m; {low:.1f} to {high:.1f} K is allowed there"
        )
    rows, across = _cubic_weights(HEIGHTS_M, height_m), _cubic_weights(OFFSETS_K, offset_k)
    depth = np.load(str(files("surveysim.atmosphere") / "tables" / HEIGHTS_TABLE), mmap_mode="r")
    # The logarithm of the optical depth is smooth in both: nearly linear in the height.
    logs = np.zeros(depth.shape[2:])
    for i, weight in rows:
        for j, other in across:
            logs += weight * other * np.log(depth[i, j].astype(float))
    pwv_mm = PWV_MM.copy()
    pwv_mm.setflags(write=False)
    return OpacityTable(EDGES_GHZ * 1e9, pwv_mm, np.exp(logs), vapour_temperature_k(height_m, offset_k))


def _cubic_weights(knots: np.ndarray, x: float) -> list[tuple[int, float]]:
    """Knots of the cubic through the four that are nearest to `x`, and their weights there."""
    first = int(np.clip(np.searchsorted(knots, x) - 2, 0, len(knots) - 4))
    near = range(first, first + 4)
    return [(i, float(np.prod([(x - knots[j]) / (knots[i] - knots[j]) for j in near if j != i]))) for i in near]


def _own_table(lines: Sequence[str]) -> OpacityTable:
    """Read an ECSV table: a column `frequency` [GHz], a column ``pwv_1.5`` for each column of water [mm], 1.5 mm here,
    and the vapour's temperature [K] as `atmosphere_temperature` in the metadata.
    """
    # By numpy, as astropy's tables take long to import.
    head = "\n".join(line for line in lines if line.startswith("#"))
    names, *rows = [line for line in lines if line and not line.startswith("#")] or [""]
    delimiter = "," if re.search(r"# delimiter: '?,", head) else None
    pwv_mm = _waters([name.strip('" ') for name in names.split(delimiter)])
    if not re.search(r"name: frequency, unit: GHz\b", head):
        raise InputError("column 'frequency': found no unit GHz in the header")
    if not (match := re.search(r"atmosphere_temperature: ([\d.]+)", head)):
        raise InputError("found no 'atmosphere_temperature' (of the vapour, in K) in the metadata")
    values = np.array([_numbers(number, row.split(delimiter), len(pwv_mm) + 1) for number, row in enumerate(rows, 1)])
    if len(values) < 2:
        raise InputError(f"found {len(values)} rows, and two or more are needed")
    centre_ghz, depth = values[:, 0], np.ascontiguousarray(values[:, 1:])
    _check_rows(np.append(True, np.diff(centre_ghz) > 0), centre_ghz, "frequencies that increase")
    _check_rows(depth.min(axis=1) >= 0, depth.min(axis=1), "optical depths of 0 or more")
    middle = (centre_ghz[1:] + centre_ghz[:-1]) / 2
    edge_ghz = np.concatenate([[2 * centre_ghz[0] - middle[0]], middle, [2 * centre_ghz[-1] - middle[-1]]])
    pwv_mm.setflags(write=False)
    return OpacityTable(edge_ghz * 1e9, pwv_mm, depth, float(match[1]))


def _waters(names: list[str]) -> np.ndarray:
    """Columns of water [mm] from the names of a table's columns."""
    found = [_COLUMN.fullmatch(name) for name in names[1:]]
    if names[:1] != ["frequency"] or not all(found):
        raise InputError(f"found the columns {shown(', '.join(names))}, and 'frequency', 'pwv_0.5', ... are expected")
    pwv_mm = np.array([float(match[1]) for match in found])
    if len(pwv_mm) < 4 or not (np.diff(pwv_mm) > 0).all() or not pwv_mm[0] > 0:
        raise InputError(f"found the columns {shown(', '.join(names))}, and four or more increasing waters are needed")
    return pwv_mm


def _numbers(row: int, cells: list[str], expected: int) -> list[float]:
    try:
        numbers = [float(cell) for cell in cells]
    except ValueError:
        numbers = []
    if len(numbers) != expected or not np.isfinite(numbers).all():
        raise InputError(f"row {row}: found {shown(' '.join(cells))}, and {expected} finite numbers are expected")
    return numbers


def _check_rows(allowed: np.ndarray, values: np.ndarray, expected: str) -> None:
    wrong = np.flatnonzero(~allowed)
    if len(wrong):
        raise InputError(f"row {wrong[0] + 1}: found {values[wrong[0]]:g}, and {expected} are expected")
