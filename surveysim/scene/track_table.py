"""Tables of the telescope's track (ECSV or CSV), as schedulers write them, and their error messages."""

import csv
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from pathlib import Path

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import read_text
from surveysim.scene.frequency_table import check_rows, column_numbers, ecsv_table
from surveysim.scene.units import shown

KEY = "scan.track_table"
MAX_BYTES = 100_000_000  # some 2 million rows, which take ten seconds
FEWEST_ROWS = 4  # of an observation, for a cubic through four of them
DAY_S = 86400.0
FIRST_MJD, LAST_MJD = 15020, 88069  # 1900-01-01 to 2199-12-31, as the dates of a schedule
_DATES = f"{FIRST_MJD} to {LAST_MJD}"
# Units of all columns; "" has none.
UNITS = {
    "observation": "",
    "start_mjd": "d",
    "mjd": "d",
    "time": "s",
    "az": "rad",
    "el": "rad",
    "ra": "rad",
    "dec": "rad",
    "flag": "",
}
_EXAMPLES = {"d": "d", "s": "s", "rad": "deg", "": ""}  # units of each kind
_HEADING = re.compile(r"\s*(\w+)\s*(?:\[\s*([^\]]*?)\s*\])?\s*")  # of a column in CSV: name [unit]
_Columns = dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class TrackTable:
    """Track of one or several observations.

    Attributes
    ----------
    bounds : (n_obs + 1,)
        First row of each observation, and the number of rows.
    start_mjd : (n_obs,)
        Start of each observation (UTC); None where the table has times since the start alone.
    time_s : (n_row,)
        Time since the start of the observation.
    on_horizon
        Whether the directions are azimuth and elevation; else right ascension and declination (ICRS).
    longitude_rad, latitude_rad : (n_row,)
        Directions of the boresight: azimuth or right ascension, elevation or declination.
    flagged : (n_row,) bool
        Rows that no map has, such as turnarounds; None without a column `flag`.
    """

    bounds: np.ndarray
    start_mjd: np.ndarray | None
    time_s: np.ndarray
    on_horizon: bool
    longitude_rad: np.ndarray
    latitude_rad: np.ndarray
    flagged: np.ndarray | None

    @property
    def n_obs(self) -> int:
        """Number of observations."""
        return len(self.bounds) - 1

    def rows(self, observation: int) -> slice:
        """Rows of an observation; those of the only one for any."""
        number = observation if self.n_obs > 1 else 0
        return slice(int(self.bounds[number]), int(self.bounds[number + 1]))

    def last_s(self) -> float:
        """Time [s] that the tracks of all observations reach."""
        return float(self.time_s[self.bounds[1:] - 1].min())

    def first_s(self) -> float:
        """Time [s] from which on the tracks of all observations are known."""
        return float(self.time_s[self.bounds[:-1]].max())


@lru_cache(maxsize=4)
def read_track(path: Path) -> TrackTable:
    """Read a track once.

    The columns are ``az`` and ``el``, or ``ra`` and ``dec`` (taken if all are there); ``time`` since the start of an
    observation or ``mjd`` (UTC); optionally ``observation`` (from 0), ``start_mjd`` beside ``time``, and ``flag``. In a
    CSV file the names of columns have their unit in brackets, as ``az [deg]``.

    Raises
    ------
    InputError
        For other columns and units, cells that are not numbers, values out of range, times that do not increase,
        observations out of order, and azimuths without a date: one line with the file and the row (from 1) or column.
    """
    try:
        lines = read_text(path, MAX_BYTES).splitlines()
        return _track(_ecsv_columns(lines) if lines and lines[0].startswith("# %ECSV") else _csv_columns(lines))
    except InputError as error:
        missing = "" if os.path.lexists(path) else "no such file in the folder of the scene"
        raise InputError(f"{KEY}: {path}: {missing or error}") from None


@lru_cache(maxsize=4)
def track_speeds(path: Path) -> tuple[float, float]:
    """Compute the mean and the largest speed of a track between neighbouring rows [rad/s], without turnarounds.

    Between azimuths and elevations the speed is that on the horizon, to which the sky moves by up to 15 arcsec/s.
    """
    table = read_track(path)
    inside = np.ones(len(table.time_s) - 1, bool)
    inside[table.bounds[1:-1] - 1] = False
    if table.flagged is not None:
        inside &= ~(table.flagged[:-1] | table.flagged[1:])
    step_s = np.diff(table.time_s)
    inside &= step_s < 1.5 * np.median(step_s[inside]) if inside.any() else inside
    cos = np.cos(table.latitude_rad)
    x, y, z = cos * np.cos(table.longitude_rad), cos * np.sin(table.longitude_rad), np.sin(table.latitude_rad)
    distance = np.sqrt(np.diff(x) ** 2 + np.diff(y) ** 2 + np.diff(z) ** 2)[inside]
    if not distance.sum():
        return 0.0, 0.0
    return float(distance.sum() / step_s[inside].sum()), float((distance / step_s[inside]).max())


# ---------------------------------------------------------------- columns


def _track(columns: _Columns) -> TrackTable:
    _check_names(tuple(columns))
    on_horizon = "ra" not in columns
    names = ("az", "el") if on_horizon else ("ra", "dec")
    for name, values in columns.items():
        check_rows(name, values, np.isfinite(values), "a number")
    for name in {"mjd", "start_mjd"}.intersection(columns):
        check_rows(name, columns[name], (columns[name] >= FIRST_MJD) & (columns[name] < LAST_MJD), _DATES)
    limits = (5.0, 90.0) if on_horizon else (-90.0, 90.0)
    degrees = np.degrees(columns[names[1]])
    allowed = (degrees >= limits[0]) & (degrees <= limits[1])
    check_rows(names[1], degrees, allowed, f"{limits[0]:g} deg to {limits[1]:g} deg", unit=" deg")
    bounds = _bounds(columns.get("observation"), len(degrees))
    first = bounds[:-1]
    start_mjd, time_s = _times(columns, first)
    if "flag" in columns and columns["flag"].all():
        raise InputError("column 'flag': found one in each row; rows without are expected, which maps have")
    later = np.append(True, np.diff(time_s) > 0)
    later[first] = time_s[first] >= 0
    check_rows("mjd" if "mjd" in columns else "time", time_s, later, "more than in the row before", unit=" s")
    return TrackTable(
        bounds,
        start_mjd,
        time_s,
        on_horizon,
        columns[names[0]],
        columns[names[1]],
        columns["flag"] != 0 if "flag" in columns else None,
    )


def _check_names(names: Sequence[str]) -> None:
    """Raise InputError unless the columns have one time, one pair of directions, and a date with azimuths."""
    wrong = [name for name in names if name not in UNITS]
    if wrong:
        raise InputError(f"column {shown(wrong[0])}: unknown; the columns {', '.join(UNITS)} are allowed")
    for pair in (("az", "el"), ("ra", "dec")):
        if len(missing := [name for name in pair if name not in names]) == 1:
            raise InputError(f"column {missing[0]!r}: missing; {' and '.join(pair)} are expected together")
    if "az" not in names and "ra" not in names:
        raise InputError(f"found the columns {', '.join(names)}; az and el, or ra and dec, are expected")
    if ("time" in names) == ("mjd" in names):
        found = "both" if "time" in names else "neither"
        raise InputError(f"columns 'time' and 'mjd': found {found}; exactly one is expected")
    if "mjd" in names and "start_mjd" in names:
        raise InputError("column 'start_mjd': found together with 'mjd'; it belongs to 'time'")
    if "ra" not in names and not {"mjd", "start_mjd"}.intersection(names):
        raise InputError(
            "column 'az': found without a date; the column 'mjd', or 'start_mjd' beside 'time', is expected with az and"
            " el"
        )


def _bounds(observation: np.ndarray | None, n_row: int) -> np.ndarray:
    """First row of each observation, and the number of rows."""
    if observation is None:
        observation = np.zeros(n_row)
    step = np.diff(observation, prepend=0.0)
    check_rows(
        "observation", observation, (step == 0) | (step == 1), "0 at first, then that of the row before or 1 more"
    )
    bounds = np.append(np.searchsorted(observation, np.arange(observation[-1] + 1 if n_row else 1)), n_row)
    short = np.flatnonzero(np.diff(bounds) < FEWEST_ROWS)
    if len(short):
        found = bounds[short[0] + 1] - bounds[short[0]]
        raise InputError(f"found {found} rows of observation {short[0]}; {FEWEST_ROWS} or more are expected")
    return bounds.astype(np.int64)


def _times(columns: _Columns, first: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
    """Starts of the observations (n_obs,), or None, and times since these (n_row,)."""
    n_row = len(next(iter(columns.values())))
    number = np.searchsorted(first, np.arange(n_row), side="right") - 1
    if "mjd" in columns:
        start = columns["mjd"][first]
        _check_starts("mjd", start, first)
        return start, (columns["mjd"] - start[number]) * DAY_S
    if "start_mjd" not in columns:
        return None, columns["time"]
    start = columns["start_mjd"][first]
    check_rows("start_mjd", columns["start_mjd"], columns["start_mjd"] == start[number], "one value an observation")
    _check_starts("start_mjd", start, first)
    return start, columns["time"]


def _check_starts(name: str, start_mjd: np.ndarray, first: np.ndarray) -> None:
    early = np.flatnonzero(np.diff(start_mjd) <= 0)
    if len(early):
        raise InputError(
            f"row {first[early[0] + 1] + 1}, column {name!r}: found {start_mjd[early[0] + 1]:.6f}; a later start than"
            " that of the observation before is expected"
        )


# ---------------------------------------------------------------- files


def _ecsv_columns(lines: list[str]) -> _Columns:
    try:
        table = ecsv_table(lines)
    except InputError:
        left = [line for line in lines if line.strip() and not line.startswith("#")]
        rows = csv.reader(left, delimiter="," if "," in "".join(left[:1]) else " ", skipinitialspace=True)
        for _ in _numbers(next(rows, []), rows):
            pass  # names the row that is wrong, if one is
        raise
    found = {}
    for name in table.colnames:
        if name == "flag" and table[name].dtype.kind == "b":
            found[name] = np.asarray(table[name], dtype=float)
        elif name in UNITS:
            found[name] = column_numbers(table, name, UNITS[name])
        else:
            found[name] = np.zeros(len(table))
    return found


def _csv_columns(lines: list[str]) -> _Columns:
    from astropy.units import Unit

    rows = csv.reader(line for line in lines if line.strip() and not line.startswith("#"))
    headings = [_HEADING.fullmatch(cell) for cell in next(rows, [])]
    if not headings or None in headings:
        raise InputError(
            f"found {shown(lines[0]) if lines else 'an empty file'}; names of columns like az [deg] are expected"
        )
    names = [heading[1] for heading in headings if heading]
    _check_names(names)
    cells = np.fromiter(chain.from_iterable(_numbers(names, rows)), float).reshape(-1, len(names))
    found = {}
    for number, heading in enumerate(filter(None, headings)):
        name, unit = heading.groups()
        if UNITS[name] and not unit:
            raise InputError(
                f"column {name!r}: found no unit, and one in brackets is expected, as {name} [{_EXAMPLES[UNITS[name]]}]"
            )
        try:
            factor = float(Unit(unit).to(UNITS[name])) if UNITS[name] else 1.0
        except Exception:  # another kind of unit, or one unknown to astropy
            expected = _EXAMPLES[UNITS[name]]
            raise InputError(
                f"column {name!r}: found the unit {shown(unit)}; one like {expected} is expected"
            ) from None
        found[name] = cells[:, number] * factor
    return found


def _numbers(names: Sequence[str], rows: Iterator[list[str]]) -> Iterator[list[float]]:
    """Convert cells to numbers; raises InputError for the first that is none, and for rows of other lengths."""
    for number, cells in enumerate(rows, start=1):
        if len(cells) != len(names):
            raise InputError(f"row {number}: found {len(cells)} cells; {len(names)} are expected")
        values = []
        for name, cell in zip(names, cells, strict=True):
            try:
                values.append(float({"True": "1", "False": "0"}.get(cell, cell)))
            except ValueError:
                raise InputError(
                    f"row {number}, column {name!r}: found {shown(cell.strip())}; a number is expected"
                ) from None
        yield values
