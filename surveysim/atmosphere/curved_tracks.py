"""Curved tracks of detectors over the layer: a rectangle of the layer for each scan.

The layer is a plane at the height h, with positions in units of h: angles at the zenith. A scan about the elevation el0
sees it at the slant distance h / sin(el0), isotropic (`surveysim.atmosphere.thin_screen`). A line of sight at the
azimuth az and the elevation el meets the plane at

    rho (sin az, cos az),    rho = cot(el0) + (el0 - el) / sin(el0),

so a scan of constant elevation follows its circle, and a small field keeps its shape. Offsets of detectors are constant
in azimuth (on the sky) and elevation, over sin(el0), and turn with the azimuth. The wind moves the plane.

The rectangle lies along the principal direction of the boresight's track in the moving plane, which is the direction
of the motion for a straight scan. It is a strip of `surveysim.atmosphere.screen_simulation`, of the width of the camera
for a straight scan and of a wider class for others.
"""

from dataclasses import dataclass, fields

import numpy as np

from surveysim.atmosphere.screen_simulation import StripCache
from surveysim.runtime.rng import NormalDeviates


@dataclass(frozen=True)
class LayerPaths:
    """Paths of the boresight over the moving layer, each in the frame of its own rectangle.

    Attributes
    ----------
    x_rad, y_rad : (n_scan, n)
        Boresight along and across the rectangle, from the middle of its bounds.
    cosine, sine : (n_scan, n)
        Turn of the detectors' offsets into the rectangle (`surveysim.atmosphere.curved_kernels`), over sin(el0).
    direction : (n_scan, 2)
        Unit vector along the rectangle.
    """

    x_rad: np.ndarray
    y_rad: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    direction: np.ndarray

    @property
    def half_length_rad(self) -> np.ndarray:
        """Half the extent of each path along its rectangle (n_scan,)."""
        return 0.5 * np.ptp(self.x_rad, axis=1)

    @property
    def half_width_rad(self) -> np.ndarray:
        """Half the extent of each path across its rectangle (n_scan,)."""
        return 0.5 * np.ptp(self.y_rad, axis=1)

    @property
    def start_rad(self) -> np.ndarray:
        """First position of the boresight from the middle of the rectangle, in the frame of the layer (n_scan, 2)."""
        normal = np.stack([-self.direction[:, 1], self.direction[:, 0]], axis=1)
        return self.x_rad[:, :1] * self.direction + self.y_rad[:, :1] * normal


def layer_positions(azimuth_rad: np.ndarray, elevation_rad: np.ndarray, centre_rad: np.ndarray) -> np.ndarray:
    """Positions (..., 2) in the plane of the layer of lines of sight about the elevation `centre_rad`."""
    rho = 1.0 / np.tan(centre_rad) + (centre_rad - elevation_rad) / np.sin(centre_rad)
    return np.stack([rho * np.sin(azimuth_rad), rho * np.cos(azimuth_rad)], axis=-1)


def horizon_vector(azimuth_rad: float, x: float | np.ndarray, y: float | np.ndarray) -> np.ndarray:
    """Turn a vector (x, y) along azimuth (on the sky) and elevation into the plane of the layer, (..., 2)."""
    cosine, sine = np.cos(azimuth_rad), np.sin(azimuth_rad)
    return np.stack([x * cosine - y * sine, -x * sine - y * cosine], axis=-1)


def layer_paths(
    *,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    time_s: np.ndarray,
    centre_rad: np.ndarray,
    layer_velocity_rad_s: np.ndarray,
) -> LayerPaths:
    """Paths of the boresight over the moving layer.

    Parameters
    ----------
    azimuth_rad, elevation_rad, time_s : (n_scan, n)
        Samples of each scan.
    centre_rad : (n_scan,)
        Elevation el0.
    layer_velocity_rad_s : (n_scan, 2)
        Velocity of the layer in its plane.
    """
    moved = layer_velocity_rad_s[:, None] * (time_s - time_s[:, :1])[..., None]
    place = layer_positions(azimuth_rad, elevation_rad, centre_rad[:, None]) - moved
    direction = _principal_directions(place)
    ahead, right = direction[:, None, 0], direction[:, None, 1]
    x = place[..., 0] * ahead + place[..., 1] * right
    y = place[..., 1] * ahead - place[..., 0] * right
    slant = 1.0 / np.sin(centre_rad)[:, None]
    cosine, sine = np.cos(azimuth_rad) * slant, np.sin(azimuth_rad) * slant
    return LayerPaths(
        _centred(x), _centred(y), cosine * ahead - sine * right, sine * ahead + cosine * right, direction
    )


def _principal_directions(place: np.ndarray) -> np.ndarray:
    """Unit vectors (n_scan, 2) along which paths (n_scan, n, 2) are longest, towards their end; x without a length."""
    off = place - place.mean(axis=1, keepdims=True)
    (xx, yy), xy = np.square(off).sum(axis=1).T, (off[..., 0] * off[..., 1]).sum(axis=1)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    backward = ((place[:, -1] - place[:, 0]) * direction).sum(axis=1) < 0.0
    return np.where(backward[:, None], -direction, direction)


def _centred(values: np.ndarray) -> np.ndarray:
    """Values (n_scan, n) from the middle between the least and the largest of each scan."""
    return values - 0.5 * (values.min(axis=1, keepdims=True) + values.max(axis=1, keepdims=True))
