"""Tracks of a survey's curved scans, for the check of the layer."""

import math
from typing import TYPE_CHECKING

import numpy as np

from surveysim.reduction.mount_check import observation_motion
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene
from surveysim.telescope.pointing import Schedule, near_angles
from surveysim.telescope.scan_pattern import ScanPattern
from surveysim.telescope.scans import Scans, mid_times
from surveysim.timestreams.simulation import observing_site, survey_horizons

if TYPE_CHECKING:
    from surveysim.atmosphere.curved_limits import BoresightMotion

LOWEST_RAD = math.radians(2.0)  # elevation of the boresight: the layer is flat, at h / sin(el)


def curved_motions(
    scene: Scene, pattern: ScanPattern, scans: Scans, times: Schedule | None
) -> "tuple[BoresightMotion, ...]":
    """Compute the motion of the boresight in the first two, the lowest and the highest of the observations.

    None for straight scans, and without a turbulent layer. Raises SceneError for a boresight near the horizon.
    """
    if scans.straight or not scene.turbulent:
        return ()
    from surveysim.atmosphere.curved_limits import BoresightMotion

    numbers = {0, min(1, scene.observations - 1)}
    if times is not None:
        elevation = near_angles(observing_site(scene), times, mid_times(scans).mean(keepdims=True))[0]
        numbers |= {int(elevation.argmin()), int(elevation.argmax())}
    horizons, motions = survey_horizons(scene, times), []
    for number in sorted(numbers):
        found = observation_motion(scene, pattern, scans, number, horizons)
        _check_elevation(found.elevation_rad, number, scans.dither_rad)
        by_scan = (
            values.reshape(scans.n_scans, -1) for values in (found.azimuth_rad, found.elevation_rad, found.time_s)
        )
        motions.append(BoresightMotion(*by_scan))
    return tuple(motions)


def _check_elevation(elevation_rad: np.ndarray, observation: int, dither_rad: float) -> None:
    """Raise SceneError for elevations too close to the horizon with some dither in both directions."""
    lowest = float(elevation_rad.min()) - dither_rad / math.sqrt(2)
    if lowest < LOWEST_RAD:
        raise SceneError(
            f"scan: found the boresight at {math.degrees(lowest):.3g} deg elevation in observation {observation}, with"
            f" its dither; {math.degrees(LOWEST_RAD):g} deg or more is expected"
        )
