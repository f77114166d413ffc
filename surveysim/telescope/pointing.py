"""Schedule of a survey and pointing of its observations."""

import math
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property, lru_cache

import numpy as np

from mapmaker.timestreams import scan_bounds
from surveysim.runtime.errors import OutOfRangeError
from surveysim.telescope.directions import FieldCentre, Site, horizontal, hour_angle_dec
from surveysim.telescope.horizon_frame import HorizonFrame, to_horizon
from surveysim.telescope.scans import ScanPath

DAY_S = 86400.0
SIDEREAL_RAD_S = 2 * np.pi * 1.00273790935 / DAY_S  # rate of the hour angle
MJD_ZERO_ORDINAL = date(1858, 11, 17).toordinal()
GOLDEN = (np.sqrt(5) - 1) / 2
_OF_SAMPLES = ("time_s", "xi_rad", "eta_rad", "azimuth_rad", "elevation_rad", "array_angle_rad")
_OF_SCANS = ("velocity_rad_s", "scan_elevation_rad", "scan_parallactic_rad", "scan_array_angle_rad")


@dataclass(frozen=True)
class Schedule:
    """Start of each observation, (n_obs,): increasing `start_mjd` (UTC), hour angle at the start, and declination of
    date.
    """

    start_mjd: np.ndarray
    hour_angle_rad: np.ndarray
    dec_rad: np.ndarray

    def some(self, which: np.ndarray | slice) -> "Schedule":
        """Select observations."""
        return Schedule(self.start_mjd[which], self.hour_angle_rad[which], self.dec_rad[which])


@dataclass(frozen=True, kw_only=True)
class Pointing:
    """Boresight and orientation of one observation; samples exist inside scans only.

    The array is fixed to an alt-azimuth mount: its y axis is at a constant angle from the vertical through the
    boresight. A fixed pointing has the centre of the field at azimuth 0, and no rotation of the array.

    Attributes
    ----------
    start_mjd
        Start of the observation (UTC).
    time_s : (n_samp,)
        Time since `start_mjd`.
    xi_rad, eta_rad : (n_samp,)
        Boresight in the tangent plane of the field.
    scan : (n_samp,)
        Number of the scan, int64.
    azimuth_rad, elevation_rad : (n_samp,)
        Boresight in the frame of the horizon; azimuth from north through east.
    array_angle_rad : (n_samp,)
        Angle of the array's y axis at the boresight: its position angle plus `mapmaker.geometry.north_angle`.
    velocity_rad_s : (n_scan, 2)
        Mean velocity of the boresight (xi, eta).
    scan_elevation_rad : (n_scan,)
        Elevation of the field centre at mid-scan.
    scan_parallactic_rad : (n_scan,)
        Position angle of the zenith at the field centre, at mid-scan.
    scan_array_angle_rad : (n_scan,)
        Position angle of the array's y axis with the boresight at the field centre, at mid-scan.
    camera_angle_rad
        Angle of the array's y axis from the vertical, in the sense of position angles.
    straight
        Whether the boresight has a constant velocity in every scan.
    flagged : (n_samp,) bool, optional
        Samples of turnarounds, which no map has; None without any.
    """

    start_mjd: float
    time_s: np.ndarray
    xi_rad: np.ndarray
    eta_rad: np.ndarray
    scan: np.ndarray
    azimuth_rad: np.ndarray
    elevation_rad: np.ndarray
    array_angle_rad: np.ndarray
    velocity_rad_s: np.ndarray
    scan_elevation_rad: np.ndarray
    scan_parallactic_rad: np.ndarray
    scan_array_angle_rad: np.ndarray
    camera_angle_rad: float
    straight: bool
    flagged: np.ndarray | None = None

    @cached_property
    def scan_bounds(self) -> np.ndarray:
        """First and one-past-last sample of each scan, (n_scan, 2)."""
        return scan_bounds(self.scan)

    def scans(self, first: int, end: int) -> "Pointing":
        """Select scans `first` to `end - 1`, renumbered from 0; the pointing itself for all of them."""
        if end - first == len(self.scan_elevation_rad):
            return self
        inside = (self.scan >= first) & (self.scan < end)
        return replace(
            self,
            scan=self.scan[inside] - first,
            **{name: getattr(self, name)[inside] for name in _OF_SAMPLES},
            **{name: getattr(self, name)[first:end] for name in _OF_SCANS},
            flagged=None if self.flagged is None else self.flagged[inside],
        )


def _half_visibility_s(
    dec_rad: np.ndarray, site: Site, max_hour_angle_rad: float, min_elevation_rad: float
) -> np.ndarray:
    """Compute the time from transit to the limit in hour angle or elevation, (nights,) [s]."""
    highest = np.pi / 2 - np.abs(site.latitude_rad - dec_rad).min()
    if highest < min_elevation_rad:
        raise OutOfRangeError(
            f"the field never rises above {np.degrees(highest):.2f} deg at this site; "
            f"the elevation limit is {np.degrees(min_elevation_rad):.2f} deg"
        )
    # sin(el) = sin(lat) sin(dec) + cos(lat) cos(dec) cos(H)
    sines = np.sin(site.latitude_rad) * np.sin(dec_rad)
    cosines = np.cos(site.latitude_rad) * np.cos(dec_rad)
    limit = np.arccos(np.clip((np.sin(min_elevation_rad) - sines) / cosines, -1.0, 1.0))
    return np.minimum(limit, max_hour_angle_rad) / SIDEREAL_RAD_S


def _check_room(n_observations: int, nights: int, half_visibility_s: np.ndarray, duration_s: float) -> None:
    """Raise OutOfRangeError if the observations do not fit into the nights."""
    visible_s = 2 * half_visibility_s.min()
    room = int(visible_s // duration_s)
    if n_observations > nights * room:
        raise OutOfRangeError(
            f"{n_observations} observations of {duration_s / 60:.1f} min do not fit into {nights} night(s): "
            f"the field can be observed for {visible_s / 60:.1f} min a night, so {nights * room} would fit "
            f"({room} a night); {_more_room(n_observations, room)} is expected"
        )


def _more_room(n_observations: int, room: int) -> str:
    """Name the keys that make room for all observations."""
    nights = f"nights = {-(-n_observations // room)} or more, " if room else ""
    return f"{nights}a larger max_hour_angle or a lower min_elevation"


def schedule(
    field: FieldCentre,
    site: Site,
    first_night: str,
    *,
    nights: int,
    n_observations: int,
    max_hour_angle_rad: float,
    min_elevation_rad: float,
    duration_s: float,
) -> Schedule:
    """Choose start times of a survey: observations spread over the nights in order, and evenly over hour angle.

    Each night has the transit nearest to local mean midnight, whether or not the Sun is up. The visibility of a night
    is the part of [-max, max] in hour angle with the field above the elevation limit; observations lie completely
    within it. Observation i belongs to night floor(i nights / n). The m observations of a night have m equal slots. All
    start at the same phase of the spare time in their slots: the middle on the first night, advanced by the golden
    ratio each night. So even few observations a night cover all hour angles, and the array rotates on the sky between
    nights. Nothing is random.

    Parameters
    ----------
    first_night
        ISO date of the local evening on which the first night begins.
    duration_s
        Duration of an observation.

    Raises
    ------
    OutOfRangeError
        If the field never reaches the elevation limit, or the observations do not fit into the nights.
    """
    midnight_mjd, hour_angle, dec = _midnights(field, site, first_night, nights)
    half_s = _half_visibility_s(dec, site, max_hour_angle_rad, min_elevation_rad)
    _check_room(n_observations, nights, half_s, duration_s)

    transit_mjd = midnight_mjd - hour_angle / SIDEREAL_RAD_S / DAY_S
    night = np.arange(n_observations) * nights // n_observations
    place = np.arange(n_observations) - np.searchsorted(night, night)
    slot_s = 2 * half_s[night] / np.bincount(night, minlength=nights)[night]
    phase = (0.5 + GOLDEN * night) % 1.0
    from_transit_s = place * slot_s - half_s[night] + phase * (slot_s - duration_s)
    start_mjd = transit_mjd[night] + from_transit_s / DAY_S
    return Schedule(start_mjd, from_transit_s * SIDEREAL_RAD_S, dec[night])


@lru_cache(maxsize=8)  # points of a sweep have nights in common
def _midnights(
    field: FieldCentre, site: Site, first_night: str, nights: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute local mean midnight [MJD] of each night, and the field's hour angle and declination of date, (nights,)
    each.
    """
    evening_mjd = date.fromisoformat(first_night).toordinal() - MJD_ZERO_ORDINAL
    east_rad = math.remainder(site.longitude_rad, 2 * math.pi)  # 204.5 degrees east are 155.5 degrees west
    midnight_mjd = evening_mjd + 1 + np.arange(nights) - east_rad / (2 * np.pi)
    return midnight_mjd, *hour_angle_dec(field, site, midnight_mjd)


def near_angles(site: Site, plan: Schedule, mid_time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute elevation and parallactic angle as `survey_angles`, in closed form, for checks.

    The declination of date is taken at the middle of each night. Elevations are right to arcseconds. Parallactic angles
    refer to the pole of date; differences within a night are not affected.
    """
    hour_angle = plan.hour_angle_rad[:, None] + SIDEREAL_RAD_S * np.asarray(mid_time_s)
    sin_dec, cos_dec = np.sin(plan.dec_rad)[:, None], np.cos(plan.dec_rad)[:, None]
    sin_up = math.sin(site.latitude_rad) * sin_dec + math.cos(site.latitude_rad) * cos_dec * np.cos(hour_angle)
    across = math.cos(site.latitude_rad) * np.sin(hour_angle)
    along = math.sin(site.latitude_rad) * cos_dec - math.cos(site.latitude_rad) * sin_dec * np.cos(hour_angle)
    return np.arcsin(np.clip(sin_up, -1, 1)), np.arctan2(across, along)


def survey_angles(
    field: FieldCentre, site: Site, start_mjd: np.ndarray, mid_time_s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Compute elevation and parallactic angle [rad], (n_obs, n_scan), at `mid_time_s` (n_scan,) after each start."""
    mjd = start_mjd[:, None] + np.asarray(mid_time_s) / DAY_S
    elevation, _, parallactic = horizontal(field, site, mjd.ravel())
    return elevation.reshape(mjd.shape), parallactic.reshape(mjd.shape)


def observation_pointing(
    path: ScanPath,
    frame: HorizonFrame | None,
    *,
    elevation_rad: np.ndarray,
    parallactic_rad: np.ndarray,
    camera_angle_rad: float,
) -> Pointing:
    """Combine a path with the angles of the field centre at mid-scan to one observation's pointing.

    Parameters
    ----------
    path
    frame
        Horizon during the observation; None at fixed pointing.
    elevation_rad, parallactic_rad : (n_scan,)
        Angles of the field centre; at fixed pointing one value each.
    camera_angle_rad
        Angle of the array's y axis from the vertical, in the sense of position angles.

    Raises
    ------
    ValueError
        For angles of other shapes.
    """
    expected = path.mid_time_s.shape
    if elevation_rad.shape != expected or parallactic_rad.shape != expected:
        raise ValueError(
            f"expected one angle a scan, {expected}; got elevation {elevation_rad.shape}, "
            f"parallactic {parallactic_rad.shape}"
        )
    if frame is None:
        azimuth, elevation, vertical = fixed_horizon(path, elevation_rad[0], parallactic_rad[0])
    else:
        azimuth, elevation, vertical = to_horizon(frame, path.time_s, path.xi_rad, path.eta_rad)
    return Pointing(
        start_mjd=frame.start_mjd if frame else 0.0,
        time_s=path.time_s,
        xi_rad=path.xi_rad,
        eta_rad=path.eta_rad,
        scan=path.scan,
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        array_angle_rad=vertical + camera_angle_rad,
        velocity_rad_s=path.velocity_rad_s,
        scan_elevation_rad=elevation_rad,
        scan_parallactic_rad=parallactic_rad,
        scan_array_angle_rad=parallactic_rad + camera_angle_rad,
        camera_angle_rad=camera_angle_rad,
        straight=path.straight,
        flagged=path.flagged,
    )


def fixed_horizon(
    path: ScanPath, elevation_rad: float, parallactic_rad: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute azimuth, elevation and vertical (n_samp,) about a field that stays at azimuth 0 without rotation."""
    cos, sin = np.cos(parallactic_rad), np.sin(parallactic_rad)
    across, along = path.eta_rad * sin - path.xi_rad * cos, path.xi_rad * sin + path.eta_rad * cos
    north, up = (
        np.cos(elevation_rad) - along * np.sin(elevation_rad),
        np.sin(elevation_rad) + along * np.cos(elevation_rad),
    )
    vertical = np.full(len(path.time_s), parallactic_rad)
    return np.arctan2(across, north), np.arctan2(up, np.hypot(across, north)), vertical


def sky_vector(angle_rad: np.ndarray, x: float | np.ndarray, y: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotate a vector (x, y) from a frame whose y axis has position angle `angle_rad` to (xi, eta); shapes broadcast.

    With the parallactic angle, (x, y) = (d azimuth cos(el), d elevation).
    """
    cos, sin = np.cos(angle_rad), np.sin(angle_rad)
    return -x * cos + y * sin, x * sin + y * cos
