"""Horizon of a site during one observation: directions in the tangent plane of a field to azimuth, elevation and back.

The chain of ERFA that `directions.horizontal` calls, sample by sample: light deflection, aberration, precession and
nutation, Earth rotation. The deflection is the field centre's for all directions. Precession and nutation are linear in
time, the observer's velocity is so between nodes. Directions within 15 degrees of the centre are right to 0.001 arcsec
(0.1 arcsec for fields 5 degrees from the Sun).
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from mapmaker.geometry import MapGeometry, north_angle
from surveysim.telescope.directions import FieldCentre, LightPath, Site, light_path

_NODE_S = 600.0  # the velocity of the site by the Earth's rotation turns by 2.5 degrees: an error of 1e-4 arcsec
_STRETCH_DAYS = 0.25  # times whose nodes are computed together
_DAY_S = 86400.0


@dataclass(frozen=True)
class HorizonFrame:
    """Horizon of a site during an observation of a field that begins at `start_mjd` (UTC)."""

    field: FieldCentre
    site: Site
    start_mjd: float


@dataclass(frozen=True)
class Horizons:
    """Horizons of all observations: the field, the site, and the starts (n_obs,) [MJD UTC]."""

    field: FieldCentre
    site: Site
    start_mjd: np.ndarray

    def of(self, observation: int) -> HorizonFrame:
        """Horizon during one observation."""
        return HorizonFrame(self.field, self.site, float(self.start_mjd[observation]))


def to_horizon(
    frame: HorizonFrame, time_s: np.ndarray, xi_rad: np.ndarray, eta_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Convert directions in the tangent plane of the field to the horizon.

    Parameters
    ----------
    frame
    time_s : (n,)
        Time since the start of the observation.
    xi_rad, eta_rad : (n,)

    Returns
    -------
    azimuth_rad, elevation_rad : (n,)
        Azimuth from north through east, in (-pi, pi]; elevation without refraction.
    vertical_rad : (n,)
        Angle of the vertical through the direction: its position angle plus `mapmaker.geometry.north_angle`.
    """
    axes, seen = _field_axes(frame.field), _Seen.at(frame, time_s)
    place = _unit(axes.T @ np.stack([xi_rad, eta_rad, np.ones_like(xi_rad)]))
    proper = _aberrated(_unit(place + seen.deflection), seen.velocity)
    north, east, up = seen.turned_to_horizon(proper)
    level = np.hypot(north, east)
    # The vertical, a vector normal to `proper`, turns as the direction does on the way back to `place`.
    vertical = seen.turned_from_horizon(-up * north / level, -up * east / level, level)
    vertical -= _dot(vertical, place) / (1 + _dot(place, proper)) * (place + proper)
    position_angle = np.arctan2(vertical[1] * place[0] - vertical[0] * place[1], vertical[2])
    in_plane = position_angle + north_angle(_tangent(frame.field), xi_rad, eta_rad)
    return np.arctan2(east, north), np.arctan2(up, level), in_plane


def from_horizon(
    frame: HorizonFrame, time_s: np.ndarray, azimuth_rad: np.ndarray, elevation_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Convert azimuth and elevation to the tangent plane of the field, the inverse of `to_horizon`.

    Returns
    -------
    xi_rad, eta_rad : (n,)
        NaN from 90 degrees off the centre on.
    """
    axes, seen = _field_axes(frame.field), _Seen.at(frame, time_s)
    level = np.cos(elevation_rad)
    proper = seen.turned_from_horizon(level * np.cos(azimuth_rad), level * np.sin(azimuth_rad), np.sin(elevation_rad))
    xi, eta, depth = axes @ (_aberrated(proper, -seen.velocity) - seen.deflection)
    depth = np.where(depth > 0, depth, np.nan)
    return xi / depth, eta / depth


@dataclass(frozen=True)
class _Seen:
    """Parameters of the apparent directions at some times (n,), as ERFA has them.

    Attributes
    ----------
    deflection : (3, 1)
        Change of the direction of the field's centre by the Sun's gravity.
    velocity : (3, n)
        Barycentric velocity of the observer over that of light.
    of_date, of_date_rate : (3, 3)
        Rotation to the pole and origin of date at the start, and its change per second.
    time_s : (n,)
    rotation_rad : (n,)
        Earth rotation angle and longitude.
    latitude_rad
    """

    deflection: np.ndarray
    velocity: np.ndarray
    of_date: np.ndarray
    of_date_rate: np.ndarray
    time_s: np.ndarray
    rotation_rad: np.ndarray
    latitude_rad: float

    @classmethod
    def at(cls, frame: HorizonFrame, time_s: np.ndarray) -> "_Seen":
        """Interpolate the parameters at times since the start of the observation."""
        first, last = (frame.start_mjd + float(time) / _DAY_S for time in (np.min(time_s), np.max(time_s)))
        path = _path_between(frame.field, frame.site, int(first // _STRETCH_DAYS), int(last // _STRETCH_DAYS))
        begin = int(np.searchsorted(path.mjd, first, side="right")) - 1
        around = slice(begin, max(begin, int(np.searchsorted(path.mjd, last)) - 1) + 2)
        nodes, seen = (path.mjd[around] - frame.start_mjd) * _DAY_S, path.seen[around]
        rate = (seen["bpn"][-1] - seen["bpn"][0]) / (nodes[-1] - nodes[0])
        return cls(
            deflection=path.deflection[around][len(nodes) // 2][:, None],
            velocity=np.stack([np.interp(time_s, nodes, axis) for axis in seen["v"].T]),
            of_date=seen["bpn"][0] - rate * nodes[0],
            of_date_rate=rate,
            time_s=time_s,
            rotation_rad=np.interp(time_s, nodes, path.rotation_rad[around]),
            latitude_rad=float(np.arctan2(seen["sphi"][0], seen["cphi"][0])),
        )

    @cached_property
    def turn(self) -> tuple[np.ndarray, np.ndarray]:
        """Cosine and sine (n,) of the rotation."""
        return np.cos(self.rotation_rad), np.sin(self.rotation_rad)

    def turned_to_horizon(self, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rotate vectors (3, n) to the axes north, east and up."""
        x, y, z = self.of_date @ vectors + self.of_date_rate @ (vectors * self.time_s)
        cos, sin = self.turn
        out, east = x * cos + y * sin, y * cos - x * sin  # `out` along the meridian's point of the equator
        cos_lat, sin_lat = math.cos(self.latitude_rad), math.sin(self.latitude_rad)
        return cos_lat * z - sin_lat * out, east, cos_lat * out + sin_lat * z

    def turned_from_horizon(self, north: np.ndarray, east: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Rotate vectors from the axes north, east and up, (3, n)."""
        cos_lat, sin_lat = math.cos(self.latitude_rad), math.sin(self.latitude_rad)
        out, z = cos_lat * up - sin_lat * north, cos_lat * north + sin_lat * up
        cos, sin = self.turn
        vectors = np.stack([out * cos - east * sin, out * sin + east * cos, z])
        return self.of_date.T @ vectors + self.of_date_rate.T @ (vectors * self.time_s)


@lru_cache(maxsize=4)  # observations of a night have them in common
def _path_between(field: FieldCentre, site: Site, first: int, last: int) -> LightPath:
    """Path of light in some stretches of time, numbered from MJD 0 on, `last` included."""
    n = round(_STRETCH_DAYS * _DAY_S / _NODE_S)
    return light_path(field, site, np.arange(first * n, (last + 1) * n + 1) * (_STRETCH_DAYS / n))


def _field_axes(field: FieldCentre) -> np.ndarray:
    """East, north and centre of a field as rows of unit vectors (3, 3)."""
    cos_ra, sin_ra = math.cos(field.ra_rad), math.sin(field.ra_rad)
    cos_dec, sin_dec = math.cos(field.dec_rad), math.sin(field.dec_rad)
    return np.array(
        [
            [-sin_ra, cos_ra, 0.0],
            [-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec],
            [cos_dec * cos_ra, cos_dec * sin_ra, sin_dec],
        ]
    )


@lru_cache(maxsize=2)  # for every observation
def _tangent(field: FieldCentre) -> MapGeometry:
    """Tangent plane of a field, for angles in it."""
    return MapGeometry(field.ra_rad, field.dec_rad, 1.0, 1, 1)


def _aberrated(direction: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """Direction (3, n) seen by an observer of a velocity over that of light: a Lorentz boost."""
    along = _dot(direction, velocity)
    inverse_gamma = np.sqrt(1 - _dot(velocity, velocity))
    return _unit(inverse_gamma * direction + (1 + along / (1 + inverse_gamma)) * velocity)


def _dot(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(_dot(vectors, vectors))
