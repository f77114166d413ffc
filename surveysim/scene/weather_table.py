"""Tables of the weather of real nights (ECSV), and their error messages."""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import read_text
from surveysim.scene.fields import B2_MAX, B2_MIN, FLUCTUATION_MAX, FLUCTUATION_MIN
from surveysim.scene.frequency_table import check_rows, column_numbers, ecsv_table
from surveysim.scene.units import shown, to_float

KEY = "atmosphere.weather_table"
COLUMNS = ("pwv", "b2", "water_fluctuation", "wind_speed", "wind_direction")
OF_B2 = ("pwv", "b2", "water_fluctuation")  # B2 follows from them
MAX_BYTES = 10_000_000  # some 150,000 rows
MJD_ZERO = np.datetime64("1858-11-17", "us")
DAY = np.timedelta64(1, "D")
_SHARES = (0.05, 0.25, 0.5, 0.75, 0.95)
_FASTEST_M_S = 1000.0
_FASTEST_RAD_S = 2 * math.pi


@dataclass(frozen=True, eq=False)
class WeatherTable:
    """Weather of real nights, a row for each time.

    Attributes
    ----------
    mjd : (n_row,)
        Times (UTC), increasing.
    columns
        Values (n_row,) by name, of some of `COLUMNS`: water [mm], B2 [mK^2 rad^(2-b)], water fluctuation [rad^(2-b)],
        wind speed in the layer [m/s, or rad/s], and the direction that the wind comes from [rad], from north through
        east.
    in_metres
        Whether the wind speed is in m/s.
    """

    path: Path
    mjd: np.ndarray
    columns: Mapping[str, np.ndarray]
    in_metres: bool

    def angular_speed(self, layer_height_m: float) -> np.ndarray:
        """Wind speeds (n_row,) of a layer overhead [rad/s]."""
        return self.columns["wind_speed"] / (layer_height_m if self.in_metres else 1.0)


@lru_cache(maxsize=8)  # points of a sweep have a table in common
def weather_table(path: Path, power: str) -> WeatherTable:
    """Read the columns `time` and some of `COLUMNS` of an ECSV table.

    Parameters
    ----------
    power
        Unit of a water fluctuation, such as "rad(-5/3)".

    Raises
    ------
    InputError
        For other columns, wrong units, times that do not increase, and values that are missing or out of range: one
        line with the key, the file and the row (from 1) or column.
    """
    try:
        return _checked(path, ecsv_table(read_text(path, MAX_BYTES).splitlines()), power)
    except InputError as error:
        missing = "" if os.path.lexists(path) else "no such file in the folder of the scene"
        raise InputError(
            f"{KEY}: {path}: {missing or error}; a table of time and some of {', '.join(COLUMNS)} is expected"
        ) from None


def _checked(path: Path, table: Any, power: str) -> WeatherTable:
    names = table.colnames
    if "time" not in names or len(names) < 2 or set(names) - {"time", *COLUMNS}:
        raise InputError(f"found the columns {shown(', '.join(names))}")
    if {"b2", "water_fluctuation"} <= set(names):
        raise InputError("column 'water_fluctuation': found together with 'b2', which follows from it")
    mjd = _times(table["time"])
    if len(mjd) < 2:
        raise InputError(f"found {len(mjd)} rows, and two or more are needed")
    columns, in_metres = {}, False
    for name in names:
        if name == "wind_speed":
            in_metres = _is_metric(table[name])
            columns[name] = _column(table, name, *_speed_rule(in_metres))
        elif name != "time":
            columns[name] = _column(table, name, *_rules(power)[name])
    return WeatherTable(path, mjd, columns, in_metres)


def _rules(power: str) -> dict[str, tuple[str, float, float, float]]:
    """Unit of each column but the wind speed, its least and largest value, and the smallest value other than 0."""
    return {
        "pwv": ("mm", 1e-3, 100.0, 0.0),
        "b2": (f"mK2 {power}", 0.0, B2_MAX, B2_MIN),
        "water_fluctuation": (power, FLUCTUATION_MIN, FLUCTUATION_MAX, 0.0),
        "wind_direction": ("rad", -2 * math.pi, 2 * math.pi, 0.0),
    }


def _is_metric(column: Any) -> bool:
    try:
        return bool(column.unit is not None and column.unit.is_equivalent("m / s"))
    except Exception:  # a unit that is unknown to astropy
        return False


def _speed_rule(in_metres: bool) -> tuple[str, float, float, float]:
    return ("m / s", 0.0, _FASTEST_M_S, 0.0) if in_metres else ("rad / s", 0.0, _FASTEST_RAD_S, 0.0)


def _column(table: Any, name: str, unit: str, least: float, most: float, smallest: float) -> np.ndarray:
    try:
        values = column_numbers(table, name, unit)
    except InputError as error:
        raise InputError(str(error).replace("one like GHz", f"one like {unit}")) from None
    inside = (values >= least * (1 - 1e-12)) & (values <= most * (1 + 1e-12)) & ((values == 0) | (values >= smallest))
    allowed = f"{least:g} to {most:g}" if not smallest else f"0 or {smallest:g} to {most:g}"
    check_rows(name, values, inside | (name == "wind_direction") & (np.abs(values) <= most * (1 + 1e-12)), allowed)
    return values


def _times(column: Any) -> np.ndarray:
    """Convert times to MJD: numbers, ISO 8601 texts, or times of astropy."""
    if hasattr(column, "utc"):
        mjd = np.asarray(column.utc.mjd, float)
    elif column.dtype.kind in "US":
        mjd = np.array([_of_text(number, text) for number, text in enumerate(column.tolist(), start=1)])
    else:
        mjd = column_numbers({"time": column}, "time", "d" if column.unit is not None else "")
    check_rows("time", mjd, (mjd > 1e4) & (mjd < 1e6), "MJD 10000 to 1000000")
    check_rows("time", mjd, np.append(True, np.diff(mjd) > 0), "more than in the row before")
    return mjd


def _of_text(row: int, text: str) -> float:
    try:
        return float((np.datetime64(text.removesuffix("Z"), "us") - MJD_ZERO) / DAY)
    except (ValueError, AttributeError):
        raise InputError(
            f"row {row}, column 'time': found {shown(text)}, and an MJD or a time like 2004-02-03T05:06:07 is allowed"
        ) from None


def date_text(mjd: float) -> str:
    """Format a time to the minute, in UTC."""
    return str((MJD_ZERO + np.timedelta64(round(mjd * 1440), "m")).astype("datetime64[m]"))


def with_table(section: Mapping[str, Any], path: object, power: str) -> dict[str, Any]:
    """Fill the distributions that an [atmosphere] leaves out with those of the rows of its table.

    Raises ValueError for a table that cannot be read.
    """
    try:
        table = weather_table(Path(str(path)), power)
        height = to_float(section["layer_height"], "m") if "layer_height" in section else None
    except InputError as error:
        raise ValueError(str(error).removeprefix("atmosphere.")) from None
    given = set(section)
    found = _wind(table, height)
    if "site" not in given and "b2" in table.columns and "b2" not in given:
        found |= _quantiles("b2", table.columns["b2"], _SHARES, f"mK2 {power}")
    if "site" in given and "pwv" in table.columns and not {"pwv", "pwv_by_month"} & given:
        found |= _quantiles("pwv", table.columns["pwv"], (0.0, *_SHARES, 1.0), "mm")
    if "site" in given and "water_fluctuation" in table.columns and "water_fluctuation" not in given:
        found |= _quantiles("water_fluctuation", table.columns["water_fluctuation"], _SHARES, power)
    return found | dict(section)


def _wind(table: WeatherTable, layer_height_m: float | None) -> dict[str, Any]:
    if "wind_speed" not in table.columns or not layer_height_m:
        return {}
    speed = table.angular_speed(layer_height_m)
    scatter = min(2.0, float(np.std(np.log(speed[speed > 0])))) if speed.any() else 0.0
    return {"wind_median": f"{float(np.median(speed))!r} rad / s", "wind_log_scatter": scatter}


def _quantiles(name: str, values: np.ndarray, shares: tuple[float, ...], unit: str) -> dict[str, Any]:
    listed = [f"{value!r} {unit}" for value in np.quantile(values, shares).tolist()]
    return {f"{name}_probabilities": list(shares), name: listed}
