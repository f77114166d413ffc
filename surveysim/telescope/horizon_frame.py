"""Horizon of a site during one observation: directions in the tangent plane of a field to azimuth, elevation and back.

The chain of ERFA that `directions.horizontal` calls, sample by sample: light deflection, aberration, precession and
nutation, Earth rotation. The deflection is the field centre's for all directions. Precession, nutation and the
observer's velocity are interpolated between nodes. Directions within 15 degrees of the centre are right to 0.001 arcsec
(0.1 arcsec for fields 5 degrees from the Sun).
"""

import math
from dataclasses import dataclass

import erfa
import numpy as np

from mapmaker.geometry import MapGeometry, north_angle
from surveysim.telescope.directions import FieldCentre, Site, light_path

_NODE_S = 600.0  # the velocity of the site by the Earth's rotation turns by 2.5 degrees: an error of 1e-4 arcsec
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
    place = _unit(np.column_stack([xi_rad, eta_rad, np.ones_like(xi_rad)]) @ axes)
    proper = erfa.ab(_unit(place + seen.deflection), seen.velocity, seen.sun_au, seen.inverse_gamma)
    north, east, up = seen.turned_to_horizon(proper)
    azimuth, elevation = np.arctan2(east, north), np.arctan2(up, np.hypot(north, east))
    # The vertical, a vector normal to `proper`, turns as the direction does on the way back to `place`.
    level = -np.sin(elevation)
    vertical = seen.turned_from_horizon(level * np.cos(azimuth), level * np.sin(azimuth), np.cos(elevation))
    share = np.einsum("ij,ij->i", vertical, place) / (1 + np.einsum("ij,ij->i", place, proper))
    vertical -= share[:, None] * (place + proper)
    position_angle = np.arctan2(vertical[:, 1] * place[:, 0] - vertical[:, 0] * place[:, 1], vertical[:, 2])
    return azimuth, elevation, position_angle + north_angle(_tangent(frame.field), xi_rad, eta_rad)


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
    natural = erfa.ab(proper, -seen.velocity, seen.sun_au, seen.inverse_gamma) - seen.deflection
    xi, eta, depth = (natural @ axes.T).T
    depth = np.where(depth > 0, depth, np.nan)
    return xi / depth, eta / depth


@dataclass(frozen=True)
class _Seen:
    """Parameters of the apparent directions at some times (n,), as ERFA has them.

    Attributes
    ----------
    deflection : (3,)
        Change of the direction of the field's centre by the Sun's gravity.
    velocity : (n, 3)
        Barycentric velocity of the observer over that of light.
    sun_au, inverse_gamma
        Distance of the Sun; root of one less the squared velocity.
    of_date : (n, 3, 3)
        Rotation to the pole and origin of date.
    rotation_rad : (n,)
        Earth rotation angle and longitude.
    latitude_rad
    """

    deflection: np.ndarray
    velocity: np.ndarray
    sun_au: float
    inverse_gamma: float
    of_date: np.ndarray
    rotation_rad: np.ndarray
    latitude_rad: float

    @classmethod
    def at(cls, frame: HorizonFrame, time_s: np.ndarray) -> "_Seen":
        """Interpolate the parameters at times since the start of the observation."""
        first, last = float(np.min(time_s)), float(np.max(time_s))
        nodes = np.linspace(first, last, 2 + int((last - first) / _NODE_S))
        path = light_path(frame.field, frame.site, frame.start_mjd + nodes / _DAY_S)
        seen, middle = path.seen, len(nodes) // 2
        turn = np.unwrap(seen["eral"])
        return cls(
            deflection=path.deflection[middle],
            velocity=_interpolated(time_s, nodes, seen["v"]),
            sun_au=float(seen["em"][middle]),
            inverse_gamma=float(seen["bm1"][middle]),
            of_date=_interpolated(time_s, nodes, seen["bpn"]),
            rotation_rad=np.interp(time_s, nodes, turn),
            latitude_rad=float(np.arctan2(seen["sphi"][0], seen["cphi"][0])),
        )

    def turned_to_horizon(self, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rotate vectors (n, 3) to the axes north, east and up."""
        x, y, z = erfa.rxp(self.of_date, vectors).T
        cos, sin = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        out, east = x * cos + y * sin, y * cos - x * sin  # `out` along the meridian's point of the equator
        cos_lat, sin_lat = math.cos(self.latitude_rad), math.sin(self.latitude_rad)
        return cos_lat * z - sin_lat * out, east, cos_lat * out + sin_lat * z

    def turned_from_horizon(self, north: np.ndarray, east: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Rotate vectors from the axes north, east and up, (n, 3)."""
        cos_lat, sin_lat = math.cos(self.latitude_rad), math.sin(self.latitude_rad)
        out, z = cos_lat * up - sin_lat * north, cos_lat * north + sin_lat * up
        cos, sin = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return erfa.trxp(self.of_date, np.column_stack([out * cos - east * sin, out * sin + east * cos, z]))


def _interpolated(time_s: np.ndarray, nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate values (n_node, ...) linearly."""
    flat = values.reshape(len(nodes), -1)
    return np.stack([np.interp(time_s, nodes, column) for column in flat.T], axis=-1).reshape(-1, *values.shape[1:])


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


def _tangent(field: FieldCentre) -> MapGeometry:
    """Tangent plane of a field, for angles in it."""
    return MapGeometry(field.ra_rad, field.dec_rad, 1.0, 1, 1)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
