"""Scans of one observation, whatever their pattern: their number, their timing, and the path of the boresight."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.scan_section import MIN_SAMPLES, ScanSection


@dataclass(frozen=True, kw_only=True)
class Scans:
    """Scans of one observation: of equal duration, with a turnaround after each.

    Attributes
    ----------
    speed_rad_s, fastest_rad_s
        Mean and largest speed of the boresight on the sky.
    n_scans
    scan_s, turnaround_s
        Durations of a scan and of the turnaround after it.
    dither_rad
        Range of the random offset of each observation.
    sample_rate_hz
    """

    speed_rad_s: float
    fastest_rad_s: float
    n_scans: int
    scan_s: float
    turnaround_s: float
    dither_rad: float
    sample_rate_hz: float

    @property
    def starts_mjd(self) -> np.ndarray | None:
        """Starts (UTC) of the observations, where the pattern sets them and the schedule does not."""
        return None

    @property
    def known_step_s(self) -> float:
        """Time within which the path is an interpolation; 0 for a closed form."""
        return 0.0

    @property
    def straight(self) -> bool:
        """True for a boresight with a constant velocity in every scan."""
        return False


@dataclass(frozen=True)
class ScanPath:
    """Boresight of one observation in the tangent plane of the field, for samples in scans.

    Attributes
    ----------
    time_s : (n_samp,)
        Time since the start of the observation.
    xi_rad, eta_rad : (n_samp,)
    scan : (n_samp,) int64
        Number of the scan.
    velocity_rad_s : (n_scan, 2)
        Mean velocity (xi, eta) of each scan.
    mid_time_s : (n_scan,)
    straight
        Whether the velocity is constant in every scan.
    flagged : (n_samp,) bool, optional
        Samples of turnarounds, which no map has; None without any.
    """

    time_s: np.ndarray
    xi_rad: np.ndarray
    eta_rad: np.ndarray
    scan: np.ndarray
    velocity_rad_s: np.ndarray
    mid_time_s: np.ndarray
    straight: bool
    flagged: np.ndarray | None = None


def timing(section: ScanSection) -> dict[str, Any]:
    """Return the arguments that `Scans` of a section [scan] have in common."""
    return {
        "speed_rad_s": section.speed_rad_s,
        "fastest_rad_s": section.fastest_rad_s,
        "n_scans": section.scans,
        "scan_s": section.scan_s,
        "turnaround_s": section.gap_s,
        "dither_rad": section.dither_rad,
        "sample_rate_hz": section.sample_rate_hz,
    }


def samples_per_scan(scans: Scans) -> int:
    """Count the whole sampling intervals in a scan; raises OutOfRangeError for fewer than `MIN_SAMPLES`."""
    # The small addition keeps a product such as 0.7 s * 10 Hz, a rounding below 7, from losing a sample.
    n = int(np.floor(scans.scan_s * scans.sample_rate_hz + 1e-6))
    if n < MIN_SAMPLES:
        raise OutOfRangeError(
            f"a scan of {scans.scan_s:g} s at {scans.sample_rate_hz:g} Hz has {n} samples; "
            f"at least {MIN_SAMPLES} are needed"
        )
    return n


def duration_s(scans: Scans) -> float:
    """Compute the time from the start of the first scan to the end of the last [s]."""
    return scans.n_scans * scans.scan_s + (scans.n_scans - 1) * scans.turnaround_s


def sample_times(scans: Scans) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the times of all samples of an observation since its start.

    Samples are at the middle of sampling intervals, symmetric about the middle of a scan; a remainder of the scan's
    duration is split between both ends.

    Returns
    -------
    time_s : (n_samp,)
    scan : (n_samp,) int64
        Number of the scan.
    mid_time_s : (n_scan,)
        Middle of each scan.
    """
    n, mid_s = samples_per_scan(scans), mid_times(scans)
    from_mid_s = (np.arange(n) + 0.5 - n / 2) / scans.sample_rate_hz
    scan = np.repeat(np.arange(scans.n_scans, dtype=np.int64), n)
    return (mid_s[:, None] + from_mid_s).ravel(), scan, mid_s


def mid_times(scans: Scans) -> np.ndarray:
    """Compute the times (n_scan,) of the middle of each scan since the start of the observation [s]."""
    return scans.scan_s / 2 + np.arange(scans.n_scans) * (scans.scan_s + scans.turnaround_s)
