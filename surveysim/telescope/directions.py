"""Apparent directions of a field at a site: elevation, azimuth, parallactic angle, hour angle, declination of date.

The routines of ERFA that astropy.coordinates calls, in the same order: ICRS to AltAz or HADec without refraction, equal
to astropy in the last bit (unit conversions too), without the time that importing it takes. UT1 = UTC and no polar
motion: an error of at most 0.9 s or 14 arcsec of hour angle. So no Earth-rotation table is read (a second at every
start) or downloaded, future dates work like past ones, and results do not depend on the installed table.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import erfa
import numpy as np

INTERPOLATION_S = 1000.0  # step of nutation and aberration: accurate to 1e-6 arcsec, and nine times faster
LIGHT_PATH_DAYS = 0.25  # the same for paths of light: accurate to 3e-4 arcsec, and one step for many observations
STEP_DOWN_RAD = 3e-4  # along the vertical through the field; the angle does not depend on it
_MJD_ZERO = 2400000.5  # Julian date
_WGS84 = 1
_SUN_DEFLECTION = 1e-6  # limit of the deflection near the Sun, as in astropy
_HOUR_RAD = np.radians(15)

_Days = tuple[np.ndarray, np.ndarray]  # whole Julian days, and the rest in [-0.5, 0.5]


@dataclass(frozen=True)
class Site:
    """Geodetic latitude, longitude (east positive) and height of the telescope."""

    latitude_rad: float
    longitude_rad: float
    height_m: float


@dataclass(frozen=True)
class FieldCentre:
    """ICRS direction of the centre of the field."""

    ra_rad: float
    dec_rad: float


def horizontal(field: FieldCentre, site: Site, mjd: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute elevation, azimuth (north through east) and parallactic angle [rad], (n,) each, at UTC `mjd` (n,).

    Without refraction. The parallactic angle, in (-pi, pi], is the position angle of the zenith relative to ICRS north,
    not to the pole of date: a point slightly below the field on its vertical is transformed back to ICRS, and the
    zenith lies in the opposite direction. (Below, so that this also works for a field at the zenith.)
    """
    with _any_year():
        seen = _astrometry(site, np.asarray(mjd, dtype=float), INTERPOLATION_S / erfa.DAYSEC)
    azimuth, zenith_distance, *_ = erfa.atioq(*_to_cirs(field, seen), seen)
    azimuth_deg, elevation_deg = np.degrees(azimuth), np.degrees(np.pi / 2 - zenith_distance)
    azimuth = np.radians(azimuth_deg)
    below = np.pi / 2 - np.radians(elevation_deg - np.degrees(STEP_DOWN_RAD))
    ra, dec = erfa.atoiq("A", azimuth, below, seen)
    nadir = _position_angle(field, *_to_icrs(ra, dec, seen))  # in [0, 2 pi)
    return np.radians(elevation_deg), azimuth, np.where(nadir > 0, nadir - np.pi, np.pi)


@dataclass(frozen=True)
class LightPath:
    """Parameters of apparent directions near a field at some times (n,).

    Attributes
    ----------
    mjd : (n,)
        UTC.
    seen : (n,)
        ERFA's astrometry parameters.
    rotation_rad : (n,)
        Earth rotation angle and longitude, without jumps.
    deflection : (n, 3)
        Change of the field's direction by the Sun's gravity.
    """

    mjd: np.ndarray
    seen: np.ndarray
    rotation_rad: np.ndarray
    deflection: np.ndarray


def light_path(field: FieldCentre, site: Site, mjd: np.ndarray) -> LightPath:
    """Compute the parameters of apparent directions near a field at UTC `mjd` (n,)."""
    with _any_year():
        seen = _astrometry(site, mjd, LIGHT_PATH_DAYS)
    place = erfa.s2c(field.ra_rad, field.dec_rad)
    return LightPath(mjd, seen, np.unwrap(seen["eral"]), _deflected(place, seen) - place)


def hour_angle_dec(field: FieldCentre, site: Site, mjd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the apparent hour angle in [-pi, pi) and the declination of date of the field, (n,) each [rad]."""
    with _any_year():
        seen = _astrometry(site, mjd)
    _, _, hour_angle, dec, _ = erfa.atioq(*_to_cirs(field, seen), seen)
    turned = hour_angle % (2 * np.pi)
    turned = turned - 2 * np.pi * (turned >= np.pi)
    return turned * (1 / _HOUR_RAD) * _HOUR_RAD, _by_degrees(dec)


@contextmanager
def _any_year() -> Iterator[None]:
    """Silence ERFA about years for which leap seconds yet to be announced may matter: again a second."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*dubious year", category=erfa.ErfaWarning)
        yield


def _astrometry(site: Site, mjd: np.ndarray, step: float | None = None) -> np.ndarray:
    """ERFA's astrometry parameters (n,), with nutation and the Earth's motion interpolated in steps of days."""
    if step is None:
        barycentric, heliocentric = _earth(mjd)
        pole = _pole(mjd)
    else:
        nodes = np.unique(np.concatenate([np.floor(mjd / step), np.ceil(mjd / step)])) * step
        at_nodes, from_sun, pole_at_nodes = _at_nodes(tuple(nodes.tolist()))
        barycentric = np.empty(mjd.shape, erfa.dt_pv)
        for part in ("p", "v"):
            barycentric[part] = np.stack([np.interp(mjd, nodes, axis) for axis in at_nodes[part].T], axis=-1)
        heliocentric = np.stack([np.interp(mjd, nodes, axis) for axis in from_sun.T], axis=-1)
        pole = tuple(np.interp(mjd, nodes, item) for item in pole_at_nodes)
    tt = _terrestrial(mjd)
    rotation = erfa.era00(*_normalised(*erfa.utcut1(*_julian(mjd), 0)))
    no_motion, no_air = (0, 0, erfa.sp00(*tt)), (0, 0)
    return erfa.apco(*tt, barycentric, heliocentric, *pole, rotation, *_geodetic(site), *no_motion, *no_air)


@lru_cache(maxsize=16)  # observations of a night have them in common
def _at_nodes(mjd: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Motion of the Earth and its pole at some times."""
    times = np.array(mjd)
    return *_earth(times), _pole(times)


def _geodetic(site: Site) -> tuple[float, float, float]:
    """Longitude, latitude [rad] and height [m], as they come back from geocentric coordinates."""
    east = np.radians(np.degrees(site.longitude_rad) % 360)
    geocentric = erfa.gd2gc(_WGS84, east, _by_degrees(site.latitude_rad), site.height_m)
    longitude, latitude, height = erfa.gc2gd(_WGS84, geocentric)
    east_deg = np.degrees(longitude % (2 * np.pi))
    return np.radians(east_deg - 360 * (east_deg >= 180)), _by_degrees(latitude), height


def _earth(mjd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric position and velocity of the Earth, and heliocentric position (n, 3) [au, au/day]."""
    tt, (day, rest) = _terrestrial(mjd), _julian(mjd)
    universal = _normalised(day - 0.5, rest)[1]
    heliocentric, barycentric = erfa.epv00(*_normalised(*erfa.tttdb(*tt, erfa.dtdb(*tt, universal, 0, 0, 0))))
    return barycentric, heliocentric["p"]


def _pole(mjd: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Celestial intermediate pole (x, y) and origin s, IAU 2006/2000A."""
    tt = _terrestrial(mjd)
    x, y = erfa.bpn2xy(erfa.pnm06a(*tt))
    return x, y, erfa.s06(*tt, x, y)


def _to_cirs(field: FieldCentre, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Right ascension and declination of date, (n,) each [rad]."""
    place = erfa.s2c(_by_degrees(field.ra_rad), _by_degrees(field.dec_rad))
    ra, dec = erfa.c2s(erfa.rxp(seen["bpn"], _aberrated(_deflected(place, seen), seen)))
    return erfa.anp(ra), dec


def _to_icrs(ra: np.ndarray, dec: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """ICRS right ascension and declination (n,) [rad] of a direction of date; iterations as in ERFA's `aticq`."""
    proper = erfa.trxp(seen["bpn"], erfa.s2c(ra, dec))
    shift = np.zeros_like(proper)
    for _ in range(2):
        before = _unit(proper - shift)
        shift = _aberrated(before, seen) - before
    natural = _unit(proper - shift)
    shift = np.zeros_like(natural)
    for _ in range(5):
        before = _unit(natural - shift)
        shift = _deflected(before, seen) - before
    ra, dec = erfa.c2s(_unit(natural - shift))
    return erfa.anp(ra), dec


def _deflected(place: np.ndarray, seen: np.ndarray) -> np.ndarray:
    return erfa.ld(1.0, place, place, seen["eh"], seen["em"], _SUN_DEFLECTION)


def _aberrated(place: np.ndarray, seen: np.ndarray) -> np.ndarray:
    return erfa.ab(place, seen["v"], seen["em"], seen["bm1"])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(np.einsum("...i,...i", vectors, vectors))[..., np.newaxis]


def _position_angle(field: FieldCentre, ra: np.ndarray, dec: np.ndarray) -> np.ndarray:
    """Position angle (n,) of other directions as seen from the field, in [0, 2 pi)."""
    turn = ra - field.ra_rad
    north = np.sin(dec) * np.cos(field.dec_rad) - np.cos(dec) * np.sin(field.dec_rad) * np.cos(turn)
    return np.arctan2(np.sin(turn) * np.cos(dec), north) % (2 * np.pi)


def _by_degrees(angle: Any) -> Any:
    """Convert to degrees and back, for the rounding of astropy."""
    return np.radians(np.degrees(angle))


def _julian(mjd: np.ndarray) -> _Days:
    day = np.round(mjd + _MJD_ZERO)
    return day, mjd - (day - _MJD_ZERO)


def _terrestrial(mjd: np.ndarray) -> _Days:
    return _normalised(*erfa.taitt(*_normalised(*erfa.utctai(*_julian(mjd)))))


def _normalised(day: np.ndarray, rest: np.ndarray) -> _Days:
    whole = np.round(day + rest)
    return whole, (day - whole) + rest
