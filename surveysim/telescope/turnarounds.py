"""Sweeps there and back: a constant speed, and turnarounds of limited acceleration and jerk between.

The acceleration of a turnaround is a trapezoid in time, or a triangle: it rises for `ramp_s`, stays, and falls for
`ramp_s`. It takes the velocity v to -v, so that the boresight comes back to the end of the sweep.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.scan_sweeps import SweepScan


@dataclass(frozen=True)
class Turnaround:
    """Motion in a turnaround that is simulated.

    Attributes
    ----------
    duration_s
    ramp_s
        Time in which the acceleration rises, and that in which it falls.
    """

    duration_s: float
    ramp_s: float


def simulated_turnaround(section: SweepScan) -> Turnaround | None:
    """Return the turnaround of a section [scan]; None where none is simulated."""
    if section.turnarounds != "flagged" or not section.turnaround_s:
        return None
    return Turnaround(section.turnaround_s, section.ramp_s)


def sweep_offsets(from_mid_s: np.ndarray, scan_s: float, turning: Turnaround | None) -> np.ndarray:
    """Distance along a forward sweep of unit speed, (n,) [s], at times from its middle.

    Parameters
    ----------
    from_mid_s : (n,)
    scan_s
        Duration of the scan, with half a turnaround at both ends if there is one.
    turning
    """
    if turning is None:
        return from_mid_s
    half_s, time = (scan_s - turning.duration_s) / 2, np.abs(from_mid_s)
    after = np.maximum(time - half_s, 0.0)
    return np.sign(from_mid_s) * (np.minimum(time, half_s) + after - 2 * _turned(after, turning))


def mean_speed(scan_s: float, turning: Turnaround | None) -> float:
    """Mean speed of a scan over that of its sweep."""
    return 1.0 if turning is None else float(sweep_offsets(np.array([scan_s / 2]), scan_s, turning)[0] * 2 / scan_s)


def step_shares(from_mid_s: np.ndarray, scan_s: float, turning: Turnaround | None) -> np.ndarray:
    """Share of the step to the next sweep that is done at times from the middle of one, (n,) in [-1/2, 1/2].

    The step is a cycloid: at rest at both ends of a turnaround, without jumps of the acceleration.
    """
    if turning is None:
        return np.zeros_like(from_mid_s)
    half_s = (scan_s - turning.duration_s) / 2
    share = np.maximum(np.abs(from_mid_s) - half_s, 0.0) / turning.duration_s
    return np.sign(from_mid_s) * (share - np.sin(2 * np.pi * share) / (2 * np.pi))


def in_turnaround(from_mid_s: np.ndarray, scan_s: float, turning: Turnaround | None) -> np.ndarray | None:
    """Return the samples (n,) bool of a scan in turnarounds; None where these are left out."""
    return None if turning is None else np.abs(from_mid_s) > (scan_s - turning.duration_s) / 2


def _turned(time_s: np.ndarray, turning: Turnaround) -> np.ndarray:
    """Integral of the share of the velocity's change that is done, in the first half of a turnaround."""
    ramp = turning.ramp_s
    rising = time_s**3 / (6 * ramp) if ramp else np.zeros_like(time_s)
    steady = time_s * (time_s - ramp) / 2 + ramp**2 / 6
    return np.where(time_s < ramp, rising, steady) / (turning.duration_s - ramp)
