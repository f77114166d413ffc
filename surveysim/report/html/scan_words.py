"""The scan pattern of a scene in words."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from surveysim.runtime.numbers import plural, short

Values = Mapping[str, Any]


def scan_words(scan: Values) -> str:
    """Describe a section [scan] in sentences, the first without its beginning; `scan` is that of `resolved`."""
    return _WORDS[scan.get("pattern", "raster")](scan)


def _raster(scan: Values) -> str:
    figure = scan.get("lissajous")
    added = f", with {_lissajous_words(figure)} added" if figure else ""
    return (
        f"{plural(scan['scans'], 'scan')} of {short(scan['duration_s'])} s at {_arcmin(scan['speed_rad_s'])}/s{added},"
        f" turnarounds of {short(scan['turnaround_s'])} s{_flagged(scan)}. Scans are {_arcmin(scan['step_rad'])} apart."
    )


def _azimuth(scan: Values) -> str:
    where = {"sky": "on the sky", "azimuth": "in azimuth"}[scan["angles"]]
    return (
        f"{plural(scan['scans'], 'sweep')} in azimuth of {_degrees(scan['throw_rad'])} at"
        f" {_degrees(scan['speed_rad_s'])}/s {where}, {_turnarounds(scan)}{_flagged(scan)}. The elevation is"
        " that of the field's centre at the middle of the observation."
    )


def _turnarounds(scan: Values) -> str:
    if scan["given_turnaround_s"] is not None:
        return f"turnarounds of {short(scan['given_turnaround_s'])} s"
    jerk = f" and {_degrees(scan['jerk_rad_s3'])}/s3" if scan["jerk_rad_s3"] else ""
    return f"turnarounds of up to {_degrees(scan['acceleration_rad_s2'])}/s2{jerk}"


def _flagged(scan: Values) -> str:
    return ", simulated and flagged" if scan.get("turnarounds") == "flagged" else ""


def _daisy(scan: Values) -> str:
    turn = f" that turns in {short(scan['rotation_period_s'])} s" if scan["rotation_period_s"] else ""
    return (
        f"a daisy of radius {_arcmin(scan['radius_rad'])}, with a period of {short(scan['radial_period_s'])} s along a"
        f" diameter{turn}, {_figure(scan)}"
    )


def _lissajous(scan: Values) -> str:
    return f"{_lissajous_words(scan)}, {_figure(scan)}"


def _lissajous_words(figure: Values) -> str:
    x, y = _arcmin(figure["amplitude_x_rad"]), _arcmin(figure["amplitude_y_rad"])
    periods = f"{short(figure['period_x_s'])} s and {short(figure['period_y_s'])} s"
    return f"a Lissajous figure of amplitudes {x} and {y}, with periods of {periods}"


def _pong(scan: Values) -> str:
    return (
        f"a pong of {_arcmin(scan['width_rad'])} by {_arcmin(scan['height_rad'])}, with lines"
        f" {_arcmin(scan['spacing_rad'])} apart at {_arcmin(scan['velocity_rad_s'])}/s, {_figure(scan)}"
    )


def _track(scan: Values) -> str:
    left_out = f", with {short(scan['turnaround_s'])} s left out between them" if scan["turnaround_s"] else ""
    return f"the track of a table, in chunks of {short(scan['duration_s'])} s{left_out}."


def _figure(scan: Values) -> str:
    axes = {"sky": "along right ascension and declination", "horizon": "along azimuth and elevation"}[scan["frame"]]
    turned = f", turned by {_degrees(scan['angle_rad'])}" if scan["angle_rad"] else ""
    step = f", {_degrees(scan['angle_step_rad'])} more in each observation" if scan["angle_step_rad"] else ""
    added = f"with {_lissajous_words(scan['lissajous'])} added, " if scan["lissajous"] else ""
    return (
        f"{added}for {short(scan['total_s'])} s in chunks of {short(scan['duration_s'])} s. Its axes are"
        f" {axes}{turned}{step}."
    )


def _degrees(angle: float) -> str:
    return f"{short(float(f'{math.degrees(angle):.9g}'))} deg"


def _arcmin(angle: float) -> str:
    return f"{short(float(f'{math.degrees(angle) * 60:.9g}'))} arcmin"


_WORDS: dict[str, Callable[[Values], str]] = {
    "raster": _raster,
    "azimuth": _azimuth,
    "daisy": _daisy,
    "lissajous": _lissajous,
    "pong": _pong,
    "track": _track,
}
