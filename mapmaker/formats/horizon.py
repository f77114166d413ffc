"""Directions of a telescope in azimuth and elevation, on the sky."""

import warnings
from dataclasses import dataclass

import numpy as np

from mapmaker.formats.rotations import sky_angles, sky_axes


@dataclass(frozen=True)
class Site:
    """Place of a telescope: longitude, latitude [deg] and altitude [m]."""

    longitude_deg: float
    latitude_deg: float
    altitude_m: float


def equatorial(
    az_rad: np.ndarray, el_rad: np.ndarray, unix_s: np.ndarray, site: Site
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right ascension, declination (ICRS) and the position angle of the zenith [rad], without refraction.

    Parameters
    ----------
    az_rad, el_rad, unix_s : (n_samp,)
        Azimuth from north through east, elevation, and time.
    site
    """
    from astropy import units as u
    from astropy.coordinates import AltAz, EarthLocation, SkyCoord
    from astropy.time import Time
    from astropy.utils import iers

    place = EarthLocation.from_geodetic(site.longitude_deg * u.deg, site.latitude_deg * u.deg, site.altitude_m * u.m)
    step = np.radians(1 / 60)  # towards the zenith
    with warnings.catch_warnings(action="ignore"), iers.conf.set_temp("auto_download", False):
        frame = AltAz(obstime=Time(unix_s, format="unix"), location=place)
        sights = []
        for elevation in (el_rad, el_rad + step):
            sky = SkyCoord(az=az_rad * u.rad, alt=elevation * u.rad, frame=frame).icrs
            sights.append(sky_axes(sky.ra.rad, sky.dec.rad)[0])
    sight, higher = sights
    up = higher - (higher * sight).sum(axis=-1, keepdims=True) * sight
    return sky_angles(sight, up)
