"""Azimuth scans: sweeps at constant elevation, which the field drifts through.

An observation stays at the elevation of the field's centre, dithered, at its middle; sweeps are symmetric about the
azimuth at that time. So fields that rise and fields that set are scanned in different directions on the sky.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.scene.scan_sweeps import AzimuthScan
from surveysim.telescope.directions import FieldCentre, Site
from surveysim.telescope.horizon_frame import HorizonFrame, from_horizon, to_horizon
from surveysim.telescope.pointing import SIDEREAL_RAD_S
from surveysim.telescope.scans import ScanPath, Scans, duration_s, mid_times, samples_per_scan, timing
from surveysim.telescope.turnarounds import Turnaround, in_turnaround, mean_speed, simulated_turnaround, sweep_offsets


@dataclass(frozen=True, kw_only=True)
class AzimuthSweeps(Scans):
    """Azimuth scans of one observation.

    Attributes
    ----------
    sweep_rad_s
        Speed of a sweep, on the sky or in azimuth.
    in_azimuth
        Whether the speed is one in azimuth.
    turning
        Turnaround that is simulated; None where they are left out.
    """

    sweep_rad_s: float
    in_azimuth: bool
    turning: Turnaround | None


def scene_azimuth(section: AzimuthScan, centre: FieldCentre, site: Site | None) -> AzimuthSweeps:
    """Make the azimuth scans of a section [scan]."""
    return AzimuthSweeps(
        **timing(section),
        sweep_rad_s=section.speed_rad_s,
        in_azimuth=section.angles == "azimuth",
        turning=simulated_turnaround(section),
    )


def azimuth_extent(scans: AzimuthSweeps, lowest_rad: float) -> float:
    """Bound the offsets from the centre of the field: half a sweep with its turnaround, and half of the drift [rad]."""
    throw = half_throw_rad(scans) * (np.cos(lowest_rad) if scans.in_azimuth else 1.0)
    return float(np.tan(min(throw + SIDEREAL_RAD_S * duration_s(scans) / 2, np.pi / 2)))


def half_throw_rad(scans: AzimuthSweeps) -> float:
    """Half a sweep with half a turnaround at its end [rad], on the sky or in azimuth."""
    return scans.sweep_rad_s * mean_speed(scans.scan_s, scans.turning) * scans.scan_s / 2


def azimuth_path(scans: AzimuthSweeps, observation: int, dither: np.ndarray, frame: HorizonFrame | None) -> ScanPath:
    """Compute the boresight path of one observation; needs the horizon."""
    assert frame is not None, "azimuth scans need a schedule"
    n, mid_s, half_s = samples_per_scan(scans), mid_times(scans), scans.scan_s / 2
    from_mid_s = (np.arange(n) + 0.5 - n / 2) / scans.sample_rate_hz
    xi, eta = _places(scans, from_mid_s, dither, frame)
    ends = np.stack(_places(scans, np.array([-half_s, half_s]), dither, frame)).reshape(2, -1, 2)
    turned = in_turnaround(from_mid_s, scans.scan_s, scans.turning)
    return ScanPath(
        time_s=(mid_s[:, None] + from_mid_s).ravel(),
        xi_rad=xi,
        eta_rad=eta,
        scan=np.repeat(np.arange(scans.n_scans), n),
        velocity_rad_s=np.diff(ends, axis=-1)[..., 0].T / scans.scan_s,
        mid_time_s=mid_s,
        straight=scans.straight,
        flagged=None if turned is None else np.tile(turned, scans.n_scans),
    )


def _places(
    scans: AzimuthSweeps, from_mid_s: np.ndarray, dither: np.ndarray, frame: HorizonFrame
) -> tuple[np.ndarray, np.ndarray]:
    """Boresight (xi, eta) of all sweeps at times from their middles, one sweep after the other."""
    azimuth, elevation, _ = to_horizon(frame, np.array([duration_s(scans) / 2]), dither[:1], dither[1:])
    speed = scans.sweep_rad_s / (1.0 if scans.in_azimuth else np.cos(elevation[0]))
    there = 1.0 - 2.0 * (np.arange(scans.n_scans) % 2)
    offset = np.outer(there, speed * sweep_offsets(from_mid_s, scans.scan_s, scans.turning)).ravel()
    time_s = (mid_times(scans)[:, None] + from_mid_s).ravel()
    return from_horizon(frame, time_s, azimuth[0] + offset, np.full(len(offset), elevation[0]))
