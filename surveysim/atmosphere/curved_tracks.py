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
from typing import TYPE_CHECKING

import numpy as np

from surveysim.atmosphere.screen_simulation import StripCache, alike_strips, centred, draw_strips
from surveysim.runtime.rng import NormalDeviates

if TYPE_CHECKING:
    from surveysim.atmosphere.scan_trends import ScanTrends

# Names of the kernels that look strips up, by `numerics.interpolation`.
CURVED_LOOK_UPS = {"nearest": "add_curved_nearest", "linear": "add_curved", "cubic": "add_curved_cubic"}


@dataclass(frozen=True)
class CurvedTracks:
    """Tracks of n_scan scans of n samples over the moving layer, each in the frame of its own rectangle.

    Attributes
    ----------
    x_rad, y_rad : (n_scan, n)
        Boresight along and across the rectangle, from its middle.
    cosine, sine : (n_scan, n)
        Turn of the detectors' offsets into the rectangle, as in `surveysim.atmosphere.curved_kernels`, over sin(el0).
    direction : (n_scan, 2)
        Unit vector along the rectangle.
    radius_rad : (n_scan,)
        Largest offset of a detector, over sin(el0).
    """

    x_rad: np.ndarray
    y_rad: np.ndarray
    cosine: np.ndarray
    sine: np.ndarray
    direction: np.ndarray
    radius_rad: np.ndarray

    @property
    def length_rad(self) -> np.ndarray:
        """Lengths of the rectangles (n_scan,)."""
        return np.ptp(self.x_rad, axis=1) + 2.0 * self.radius_rad

    @property
    def half_width_rad(self) -> np.ndarray:
        """Half the widths of the rectangles (n_scan,)."""
        return 0.5 * np.ptp(self.y_rad, axis=1) + self.radius_rad

    def corner_rad(self, strips: StripCache) -> np.ndarray:
        """First points of the scans' strips, relative to the first positions of the boresight (n_scan, 2)."""
        normal = np.stack([-self.direction[:, 1], self.direction[:, 0]], axis=1)
        along, across = 0.5 * self.length_rad + self.x_rad[:, 0], strips.strip_half_width_rad + self.y_rad[:, 0]
        return -along[:, None] * self.direction - across[:, None] * normal

    def scans(self, first: int, end: int) -> "CurvedTracks":
        """Select scans `first` to `end - 1`."""
        return CurvedTracks(*(getattr(self, item.name)[first:end] for item in fields(self)))


def layer_positions(azimuth_rad: np.ndarray, elevation_rad: np.ndarray, centre_rad: np.ndarray) -> np.ndarray:
    """Positions (..., 2) in the plane of the layer of lines of sight about the elevation `centre_rad`."""
    rho = 1.0 / np.tan(centre_rad) + (centre_rad - elevation_rad) / np.sin(centre_rad)
    return np.stack([rho * np.sin(azimuth_rad), rho * np.cos(azimuth_rad)], axis=-1)


def horizon_vector(azimuth_rad: float, x: float | np.ndarray, y: float | np.ndarray) -> np.ndarray:
    """Turn a vector (x, y) along azimuth (on the sky) and elevation into the plane of the layer, (..., 2)."""
    cosine, sine = np.cos(azimuth_rad), np.sin(azimuth_rad)
    return np.stack([x * cosine - y * sine, -x * sine - y * cosine], axis=-1)


def curved_tracks(
    *,
    azimuth_rad: np.ndarray,
    elevation_rad: np.ndarray,
    time_s: np.ndarray,
    centre_rad: np.ndarray,
    layer_velocity_rad_s: np.ndarray,
    radius_rad: float,
) -> CurvedTracks:
    """Tracks of scans over the moving layer.

    Parameters
    ----------
    azimuth_rad, elevation_rad, time_s : (n_scan, n)
        Samples of each scan.
    centre_rad : (n_scan,)
        Elevation el0.
    layer_velocity_rad_s : (n_scan, 2)
        Velocity of the layer in its plane.
    radius_rad
        Largest offset of a detector.
    """
    moved = layer_velocity_rad_s[:, None] * (time_s - time_s[:, :1])[..., None]
    place = layer_positions(azimuth_rad, elevation_rad, centre_rad[:, None]) - moved
    direction = _principal_directions(place)
    ahead, right = direction[:, None, 0], direction[:, None, 1]
    slant = 1.0 / np.sin(centre_rad)
    cosine, sine = np.cos(azimuth_rad) * slant[:, None], np.sin(azimuth_rad) * slant[:, None]
    return CurvedTracks(
        x_rad=_centred(place[..., 0] * ahead + place[..., 1] * right),
        y_rad=_centred(place[..., 1] * ahead - place[..., 0] * right),
        cosine=cosine * ahead - sine * right,
        sine=sine * ahead + cosine * right,
        direction=direction,
        radius_rad=radius_rad * slant,
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


def add_along_curves(
    data_mk: np.ndarray,
    scan_bounds: np.ndarray,
    *,
    tracks: CurvedTracks,
    offsets_rad: np.ndarray,
    amplitude_mk: np.ndarray,
    strips: StripCache,
    deviates: NormalDeviates,
    trends: "ScanTrends",
    mean_removed: bool = False,
) -> None:
    """Add the emission of the moving layer along given tracks to time-streams, in place.

    Parameters
    ----------
    data_mk : (n_det, n_samp)
        Streams, float32 or float64.
    scan_bounds : (n_scan, 2)
        First sample and end of each scan.
    tracks : CurvedTracks
    offsets_rad : (n_det, 2)
        Offsets of the detectors in azimuth (on the sky) and elevation.
    amplitude_mk : (n_scan, n)
        sqrt(B2 / sin(el)) of each sample.
    strips : StripCache
        Strips that are as wide as the widest rectangle.
    deviates, trends
        As for `surveysim.atmosphere.screen_simulation.add_along_tracks`.
    mean_removed
        Whether the layer has a mean of 0 over the strip of each scan, as a realization that others join.

    Raises
    ------
    ValueError
        Where a detector is outside its strip.
    """
    from surveysim.atmosphere import curved_kernels

    add_layer, step = getattr(curved_kernels, CURVED_LOOK_UPS[strips.interpolation]), strips.step_rad
    x = (tracks.x_rad + 0.5 * tracks.length_rad[:, None]) / step
    y = (tracks.y_rad + strips.strip_half_width_rad) / step
    u, v = np.ascontiguousarray(offsets_rad.T) / step
    for strip, scans, first in alike_strips(strips, tracks.length_rad):
        layers = draw_strips(strip, deviates, first)
        trends.impose(scans, layers)
        for scan, layer in zip(scans, layers, strict=True):
            if mean_removed:
                centred(layer, tracks.length_rad[scan] / step)
            turn = tracks.cosine[scan], tracks.sine[scan]
            add_layer(data_mk, *scan_bounds[scan], layer, x[scan], y[scan], *turn, amplitude_mk[scan], u, v)
