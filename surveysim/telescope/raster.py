"""Raster scans of the field.

Scans parallel to right ascension or declination are straight lines in the tangent plane of the field centre, along
its `xi` (east) or `eta` (north) axis. A line of constant declination deviates from it by xi^2 tan(dec) / 2: 26 arcsec
at 1 degree and 7 arcsec at 30 arcmin from the centre of a field at 40 degrees. Maps are binned where the telescope
points, so only the coverage differs.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.observing import MIN_SAMPLES


@dataclass(frozen=True)
class Raster:
    """Raster of one observation (paper, "Instrument Description").

    Attributes
    ----------
    speed_rad_s
        Speed of the boresight in a scan.
    n_scans
    scan_s, turnaround_s
        Durations of a scan and of the turnaround after it.
    step_rad
        Distance of neighbouring scans.
    dither_rad
        Range of the random offset of each observation.
    sample_rate_hz
    """

    speed_rad_s: float
    n_scans: int
    scan_s: float
    turnaround_s: float
    step_rad: float
    dither_rad: float
    sample_rate_hz: float


@dataclass(frozen=True)
class RasterPath:
    """Boresight of one observation in the tangent plane of the field, for samples in scans.

    Attributes
    ----------
    time_s : (n_samp,)
        Time since the start of the observation.
    xi_rad, eta_rad : (n_samp,)
    scan : (n_samp,) int64
        Number of the scan.
    velocity_rad_s : (n_scan, 2)
        Constant velocity (xi, eta) of each scan.
    mid_time_s : (n_scan,)
    """

    time_s: np.ndarray
    xi_rad: np.ndarray
    eta_rad: np.ndarray
    scan: np.ndarray
    velocity_rad_s: np.ndarray
    mid_time_s: np.ndarray


def samples_per_scan(raster: Raster) -> int:
    """Count the whole sampling intervals in a scan; raises OutOfRangeError for fewer than `MIN_SAMPLES`."""
    # The small addition keeps a product such as 0.7 s * 10 Hz, a rounding below 7, from losing a sample.
    n = int(np.floor(raster.scan_s * raster.sample_rate_hz + 1e-6))
    if n < MIN_SAMPLES:
        raise OutOfRangeError(
            f"a scan of {raster.scan_s:g} s at {raster.sample_rate_hz:g} Hz has {n} samples; "
            f"at least {MIN_SAMPLES} are needed"
        )
    return n


def duration_s(raster: Raster) -> float:
    """Compute the time from the start of the first scan to the end of the last [s]."""
    return raster.n_scans * raster.scan_s + (raster.n_scans - 1) * raster.turnaround_s


def mid_times(raster: Raster) -> np.ndarray:
    """Compute the times (n_scan,) of the middle of each scan since the start of the observation [s]."""
    return raster.scan_s / 2 + np.arange(raster.n_scans) * (raster.scan_s + raster.turnaround_s)


def raster(raster: Raster, along: str, dither: np.ndarray) -> RasterPath:
    """Compute the boresight path of one observation.

    The first scan goes east (or north), the next one back, each `step_rad` further north (or east). The pattern is
    centred on the field plus the dither. Sample i of a scan is (i + 1/2) / rate after its start, so a scan is symmetric
    about its middle; a remainder of its duration is split between both ends.

    Parameters
    ----------
    along
        "ra" (xi) or "dec" (eta).
    dither : (2,)
        Offset of the pattern [rad].

    Raises
    ------
    ValueError
        For another direction, and for scans with too few samples (`samples_per_scan`).
    """
    if along not in ("ra", "dec"):
        raise ValueError(f'scans go along "ra" or "dec", not {along!r}')
    n = samples_per_scan(raster)
    k = np.arange(raster.n_scans)
    mid_s = mid_times(raster)
    from_mid_s = (np.arange(n) + 0.5 - n / 2) / raster.sample_rate_hz
    speed = raster.speed_rad_s * (1.0 - 2.0 * (k % 2))
    along_rad = np.outer(speed, from_mid_s)
    across_rad = np.repeat((k - (raster.n_scans - 1) / 2) * raster.step_rad, n)
    axis = ("ra", "dec").index(along)
    offset = np.empty((2, raster.n_scans * n))
    offset[axis] = along_rad.ravel() + dither[axis]
    offset[1 - axis] = across_rad + dither[1 - axis]
    velocity = np.zeros((raster.n_scans, 2))
    velocity[:, axis] = speed
    return RasterPath(
        time_s=(mid_s[:, None] + from_mid_s).ravel(),
        xi_rad=offset[0],
        eta_rad=offset[1],
        scan=np.repeat(k.astype(np.int64), n),
        velocity_rad_s=velocity,
        mid_time_s=mid_s,
    )
