"""Tracks against the limits of the mount: velocity, acceleration and jerk in azimuth and elevation."""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.telescope import TelescopeSection

AXES = ("azimuth", "elevation")
NAMES = ("velocity", "acceleration", "jerk")
_UNITS = ("deg / s", "deg / s2", "deg / s3")


@dataclass(frozen=True)
class Motion:
    """Directions of the mount at some times of one observation.

    Attributes
    ----------
    time_s, azimuth_rad, elevation_rad : (n,)
        Time since the start of the observation, azimuth without jumps of a turn, and elevation.
    """

    time_s: np.ndarray
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray

    def thinned(self, step_s: float) -> "Motion":
        """Leave out samples until those within a scan are at least a step apart."""
        own_s = float(np.min(np.diff(self.time_s)))
        every = max(1, int(np.ceil(step_s / own_s * (1 - 1e-9))))
        return Motion(self.time_s[::every], self.azimuth_rad[::every], self.elevation_rad[::every])


def limit_excess(section: TelescopeSection, motion: Motion, observation: int) -> tuple[float, str]:
    """Compare a track with all limits.

    Returns
    -------
    ratio
        Largest ratio of a derivative to its limit; 0 without limits.
    sentence
        Error about it: key, found, where and when, allowed.
    """
    worst = (0.0, "")
    for axis in AXES if len(motion.time_s) > 1 else ():
        found = derivatives(motion.time_s, getattr(motion, f"{axis}_rad"))
        for order, (time_s, values) in enumerate(found, start=1):
            limit = section.limit(axis, order)
            if limit is not None and len(values):
                most = int(np.argmax(np.abs(values)))
                elevation = np.interp(time_s[most], motion.time_s, motion.elevation_rad)
                where = f"observation {observation} at {np.degrees(elevation):.1f} deg elevation, {time_s[most]:.4g} s"
                sentence = _too_fast(axis, order, abs(values[most]), limit, where)
                worst = max(worst, (float(abs(values[most])) / limit, sentence))
    return worst


def derivatives(time_s: np.ndarray, values: np.ndarray) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Compute times and values of velocity, acceleration and jerk of a track by divided differences.

    Samples more than 1.5 steps apart belong to different scans. Across the time between two scans the acceleration is
    the mean one that the change of velocity takes, and there is no jerk.
    """
    step_s = np.diff(time_s).min()
    inside = np.diff(time_s) < 1.5 * step_s
    velocity_s, velocity = _middles(time_s)[inside], (np.diff(values) / np.diff(time_s))[inside]
    passed_s = np.diff(velocity_s)
    inside = passed_s < 1.5 * step_s
    # The velocity of a scan lasts until its end, a step after the middle of its last pair of samples.
    acceleration_s, acceleration = _middles(velocity_s), np.diff(velocity) / (passed_s - 2 * step_s * ~inside)
    inside = inside[1:] & inside[:-1]
    jerk_s, jerk = _middles(acceleration_s)[inside], (np.diff(acceleration) / np.diff(acceleration_s))[inside]
    return (velocity_s, velocity), (acceleration_s, acceleration), (jerk_s, jerk)


def _middles(values: np.ndarray) -> np.ndarray:
    return (values[1:] + values[:-1]) / 2


def _too_fast(axis: str, order: int, found: float, limit: float, where: str) -> str:
    name, unit = NAMES[order - 1], _UNITS[order - 1]
    return (
        f"telescope.max_{axis}_{name}: found {np.degrees(found):.4g} {unit} in {where} after its start;"
        f" {np.degrees(limit):.4g} {unit} or less is expected"
    )
