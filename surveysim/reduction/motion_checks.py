"""Motion of the sky within a scan, against the model of the layer, and sweeps in azimuth."""

import math

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene
from surveysim.telescope.directions import Site
from surveysim.telescope.patterns.azimuth import AzimuthSweeps, half_throw_rad
from surveysim.telescope.pointing import SIDEREAL_RAD_S, Schedule, near_angles
from surveysim.telescope.scans import Scans, mid_times

SCANS_AT_ONCE = 200_000  # scans whose angles are checked together
# Largest rotation of the array in the layer in half a scan. Separations of detectors along the motion of the layer
# change by as much: to one side in the first half and to the other in the second, so that they are right on average.
MAX_TURN_RAD = 0.05
MAX_AIRMASS_CHANGE = 0.02  # largest relative change in half a scan: 2.7 % of the layer's amplitude at an index of 11/3
MAX_THROW_RAD = math.pi  # of a sweep in azimuth: longer ones turn about the zenith


def check_motion(scene: Scene, site: Site, starts: Schedule, scans: Scans) -> float:
    """Raise SceneError where the pointing departs too far from the model of the layer or from sweeps in azimuth.

    A straight scan has the layer at one airmass and one array angle. Exact angles are computed only for scans that may
    exceed the limits at the largest possible rates for their elevation. Other patterns have angles of each sample.

    Returns
    -------
    float
        Lowest elevation [rad] of all scans.
    """
    mid_time_s = mid_times(scans)
    lowest = math.inf
    step = max(1, SCANS_AT_ONCE // len(mid_time_s))
    for first in range(0, len(starts.start_mjd), step):
        some = np.arange(first, min(first + step, len(starts.start_mjd)))
        elevation, parallactic = near_angles(site, starts.some(some), mid_time_s)
        lowest = min(lowest, float(elevation.min()))
        if isinstance(scans, AzimuthSweeps):
            _check_throw(scans, float(elevation.max()))
        if not scans.straight:
            continue
        _check_some_motion(
            scene,
            site,
            starts,
            mid_time_s=mid_time_s,
            which=some,
            elevation_rad=elevation,
            parallactic_rad=parallactic,
        )
    return lowest


def _check_some_motion(
    scene: Scene,
    site: Site,
    starts: Schedule,
    *,
    mid_time_s: np.ndarray,
    which: np.ndarray,
    elevation_rad: np.ndarray,
    parallactic_rad: np.ndarray,
) -> None:
    """Check the observations `which` (n,) with mid-scan angles (n, n_scan)."""
    half_s = scene.scan.duration_s / 2
    most_up_rad = half_s * SIDEREAL_RAD_S * math.cos(site.latitude_rad)
    most_turn_rad = most_up_rad / np.cos(np.minimum(elevation_rad + most_up_rad, math.pi / 2))
    most_airmass = np.sin(elevation_rad) / np.sin(np.maximum(elevation_rad - most_up_rad, 1e-3)) - 1
    doubtful = (most_turn_rad > MAX_TURN_RAD) | (most_airmass > MAX_AIRMASS_CHANGE)
    rows = np.flatnonzero(doubtful.any(axis=1))
    for side in (-half_s, half_s):
        end_up, end_angle = near_angles(site, starts.some(which[rows]), mid_time_s + side)
        turn = np.abs((end_angle - parallactic_rad[rows] + math.pi) % (2 * math.pi) - math.pi)
        change = np.abs(np.sin(elevation_rad[rows]) / np.sin(np.maximum(end_up, 1e-3)) - 1)
        wrong = (turn > MAX_TURN_RAD) | (change > MAX_AIRMASS_CHANGE)
        for place in np.flatnonzero(wrong.any(axis=1))[:1]:
            number, up = int(which[rows[place]]), elevation_rad[rows[place]]
            _check_turn(number, up, turn[place])
            _check_airmass(number, up, change[place])


def _check_throw(scans: AzimuthSweeps, up_rad: float) -> None:
    throw_rad = 2 * half_throw_rad(scans) / (1.0 if scans.in_azimuth else max(math.cos(up_rad), 1e-9))
    if throw_rad > MAX_THROW_RAD:
        raise SceneError(
            f"scan.throw: found sweeps of {math.degrees(throw_rad):.4g} deg in azimuth with their turnarounds, at"
            f" {math.degrees(up_rad):.1f} deg elevation; {math.degrees(MAX_THROW_RAD):g} deg or less is expected"
        )


def _check_turn(number: int, up_rad: np.ndarray, turn_rad: np.ndarray) -> None:
    worst = int(np.argmax(turn_rad))
    if turn_rad[worst] > MAX_TURN_RAD:
        raise SceneError(
            f"scan.duration: found scans of observation {number}, at {math.degrees(up_rad[worst]):.1f} deg elevation,"
            f" during which the sky turns by {math.degrees(turn_rad[worst]):.2g} deg in half a scan;"
            f" {math.degrees(MAX_TURN_RAD):.2g} deg or less is expected: shorter scans, or a field that stays away from"
            " the zenith"
        )


def _check_airmass(number: int, up_rad: np.ndarray, change: np.ndarray) -> None:
    worst = int(np.argmax(change))
    if change[worst] > MAX_AIRMASS_CHANGE:
        raise SceneError(
            f"scan.duration: found scans of observation {number}, at {math.degrees(up_rad[worst]):.1f} deg elevation,"
            f" in half of which the airmass changes by {change[worst]:.2g} of itself; {MAX_AIRMASS_CHANGE:g} or less is"
            " expected: shorter scans, or a higher schedule.min_elevation"
        )
