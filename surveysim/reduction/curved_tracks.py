"""Tracks of a survey's curved scans, for the check of the layer."""

from typing import TYPE_CHECKING

from surveysim.reduction.mount_check import observation_motion
from surveysim.scene.scene import Scene
from surveysim.telescope.pointing import Schedule, near_angles
from surveysim.telescope.scan_pattern import ScanPattern
from surveysim.telescope.scans import Scans, mid_times
from surveysim.timestreams.simulation import observing_site, survey_horizons

if TYPE_CHECKING:
    from surveysim.atmosphere.curved_limits import BoresightMotion


def curved_motions(
    scene: Scene, pattern: ScanPattern, scans: Scans, times: Schedule | None
) -> "tuple[BoresightMotion, ...]":
    """Compute the motion of the boresight in the first two, the lowest and the highest of the observations.

    None for straight scans, and without a turbulent layer.
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
        by_scan = (
            values.reshape(scans.n_scans, -1) for values in (found.azimuth_rad, found.elevation_rad, found.time_s)
        )
        motions.append(BoresightMotion(*by_scan))
    return tuple(motions)
