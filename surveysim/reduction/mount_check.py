"""Tracks of a survey against the limits of the telescope's mount."""

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene
from surveysim.telescope.horizon_frame import Horizons, to_horizon
from surveysim.telescope.mount_limits import Motion, limit_excess
from surveysim.telescope.pointing import Schedule, fixed_horizon, near_angles
from surveysim.telescope.scan_pattern import ScanPattern
from surveysim.telescope.scans import Scans, mid_times
from surveysim.timestreams.simulation import observing_site, survey_horizons

ROUNDING = 1e-6  # by which a track may exceed a limit
CHECKED = 8  # observations whose tracks are checked, of many


def check_mount(scene: Scene, pattern: ScanPattern, scans: Scans, times: Schedule | None) -> None:
    """Raise SceneError, with the largest excess, for tracks that are too fast; without [telescope] nothing is computed.

    Of many observations those nearest to the zenith are checked, where azimuths move fastest, and as many others.
    """
    if scene.telescope is None:
        return
    horizons = survey_horizons(scene, times)
    worst = (0.0, "")
    for number in _checked(scene, times, mid_times(scans)):
        motion = observation_motion(scene, pattern, scans, number, horizons)
        found = limit_excess(scene.telescope, motion.thinned(scans.known_step_s), number)
        worst = found if found[0] > worst[0] * (1 + ROUNDING) else worst
    if worst[0] > 1 + ROUNDING:
        raise SceneError(worst[1])


def observation_motion(
    scene: Scene, pattern: ScanPattern, scans: Scans, observation: int, horizons: Horizons | None
) -> Motion:
    """Compute the directions of the mount in one observation, without its dither."""
    frame = horizons.of(observation) if horizons else None
    path = pattern.path(scans, observation, np.zeros(2), frame)
    if frame is None:
        fixed = scene.fixed_pointing
        azimuth, elevation, _ = fixed_horizon(path, fixed.elevation_rad, fixed.parallactic_angle_rad)
    else:
        azimuth, elevation, _ = to_horizon(frame, path.time_s, path.xi_rad, path.eta_rad)
    return Motion(path.time_s, np.unwrap(azimuth), elevation)


def _checked(scene: Scene, times: Schedule | None, mid_time_s: np.ndarray) -> list[int]:
    """Numbers of the observations to check: half of them the highest, of both parities, half evenly spread."""
    if scene.observations <= CHECKED:
        return list(range(scene.observations))
    some = set(np.linspace(0, scene.observations - 1, CHECKED // 2).astype(int).tolist())
    if times is not None:
        highest = near_angles(observing_site(scene), times, mid_time_s)[0].max(axis=1)
        order = np.argsort(-highest, kind="stable")
        for parity in (0, 1):
            some.update(order[order % 2 == parity][: CHECKED // 4].tolist())
    return sorted(some)
