"""Dependence of a survey's weather on its dates: seasons, drift, and tables of real nights."""

import numpy as np

from surveysim.atmosphere.dated_weather import DAY_S, DatedWeather, dated_weather
from surveysim.atmosphere.water import seasons
from surveysim.runtime.errors import SceneError
from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.scene import Scene
from surveysim.scene.weather_table import KEY, WeatherTable, date_text
from surveysim.telescope.pointing import SIDEREAL_RAD_S, Schedule

LONGEST_GAP = 1.0  # days between rows that are interpolated


def survey_dates(scene: Scene, times: Schedule | None, *, duration_s: float) -> DatedWeather | None:
    """Return the dependence of the weather on the dates of all observations; None without any.

    Parameters
    ----------
    times
        Starts of the observations; None without a schedule.
    duration_s
        Duration of an observation.

    Raises
    ------
    SceneError
        For an observation that a table of weather does not cover.
    """
    air = scene.atmosphere
    if times is None or air is None:
        return None
    by_month = seasons(times.start_mjd, scene.schedule.longitude_rad) if air.pwv_by_month else None
    known = _known(scene, air, air.table, times, duration_s) if air.table else None
    if not (by_month or known or air.correlation_time_s):
        return None
    return dated_weather(
        scene.seed, tuple(times.start_mjd.tolist()), correlation_s=air.correlation_time_s, seasons=by_month, known=known
    )


def _known(
    scene: Scene, air: Atmosphere, table: WeatherTable, times: Schedule, duration_s: float
) -> tuple[tuple[str, tuple[float, ...]], ...]:
    """Interpolate a table to the middle of each observation: values (n_obs,) by name, the wind in azimuth-elevation."""
    mjd = times.start_mjd + duration_s / 2 / DAY_S
    _check_covered(table, mjd)
    elevation, azimuth = _directions(scene.schedule.latitude_rad, times, duration_s / 2)
    rows = dict(table.columns)
    if "wind_direction" in rows:
        rows["wind_direction"] = np.unwrap(rows["wind_direction"])
    if "wind_speed" in rows:
        rows["wind_speed"] = table.angular_speed(air.layer_height_m)
    found = {name: np.interp(mjd, table.mjd, values) for name, values in rows.items()}
    if table.in_metres:
        found["wind_speed"] *= np.sin(elevation)  # the layer is at h / sin(el)
    if "wind_direction" in found:
        # It comes from there. The layer that recedes at the azimuth of the field moves down.
        found["wind_direction"] = (found["wind_direction"] + np.pi - azimuth - np.pi / 2) % (2 * np.pi)
    return tuple((name, tuple(values.tolist())) for name, values in found.items())


def _check_covered(table: WeatherTable, mjd: np.ndarray) -> None:
    """Raise SceneError for an observation before the first row, after the last or in a gap."""
    after = np.searchsorted(table.mjd, mjd)
    before, after = table.mjd[np.maximum(after - 1, 0)], table.mjd[np.minimum(after, len(table.mjd) - 1)]
    outside = (mjd < table.mjd[0]) | (mjd > table.mjd[-1])
    missed = np.flatnonzero(outside | (after - before > LONGEST_GAP))
    if not len(missed):
        return
    first = missed[0]
    covered = f"covers {date_text(table.mjd[0])} to {date_text(table.mjd[-1])} UTC"
    gap = f"has no row from {date_text(before[first])} to {date_text(after[first])} UTC"
    raise SceneError(
        f"{KEY}: {table.path} {covered if outside[first] else gap}; {len(missed)} of {len(mjd)} observations"
        f" lie outside, the first, number {first}, at {date_text(mjd[first])}"
    )


def _directions(latitude_rad: float, times: Schedule, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute elevation and azimuth (n_obs,), from north through east, of the field some seconds after each start."""
    hour_angle, dec = times.hour_angle_rad + SIDEREAL_RAD_S * seconds, times.dec_rad
    east = -np.cos(dec) * np.sin(hour_angle)
    north = np.sin(dec) * np.cos(latitude_rad) - np.cos(dec) * np.sin(latitude_rad) * np.cos(hour_angle)
    up = np.sin(dec) * np.sin(latitude_rad) + np.cos(dec) * np.cos(latitude_rad) * np.cos(hour_angle)
    return np.arcsin(np.clip(up, -1, 1)), np.arctan2(east, north)
