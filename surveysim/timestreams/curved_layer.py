"""The atmosphere of scans whose tracks are curved."""

from typing import TYPE_CHECKING

import numpy as np

from mapmaker.geometry import sky_offsets
from mapmaker.timestreams import scan_bounds
from surveysim.atmosphere.curved_tracks import (
    add_along_curves,
    curved_tracks,
    horizon_vector,
    layer_positions,
)
from surveysim.runtime.rng import NormalDeviates
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import Simulation

if TYPE_CHECKING:
    from surveysim.atmosphere.screen_simulation import SlantStrips


def add_curved_layer(
    data: np.ndarray,
    setup: Simulation,
    pointing: Pointing,
    block: Block,
    *,
    strips: "SlantStrips",
    wind_rad_s: tuple[float, float],
    b2: float,
    of_trends: NormalDeviates,
    deviates: NormalDeviates,
) -> None:
    """Add one realization of a moving layer to streams (n_det, n_samp) [mK] of one block, in place.

    Parameters
    ----------
    pointing
        Pointing of the whole observation.
    wind_rad_s
        Angular velocity of the layer along azimuth (on the sky) and elevation, at the mean azimuth of the observation.
    b2
        Amplitude at the zenith, over that of the sky's brightness seen through the air.
    of_trends
        Random numbers of the trends that all scans share.
    deviates
        Random numbers of the strips of the block.
    """
    from surveysim.atmosphere.scan_trends import draw_trends, strip_points

    bounds = scan_bounds(pointing.scan)
    shape = len(bounds), -1
    azimuth, elevation = pointing.azimuth_rad.reshape(shape), pointing.elevation_rad.reshape(shape)
    time, centre = pointing.time_s.reshape(shape), elevation.mean(axis=1)
    velocity = _layer_velocity(pointing.azimuth_rad, centre, wind_rad_s)
    tracks = curved_tracks(
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        time_s=time,
        centre_rad=centre,
        layer_velocity_rad_s=velocity,
        radius_rad=strips.half_width_rad,
    )
    cache = strips.at(float(np.sin(centre).min()), float(tracks.half_width_rad.max()))
    start = layer_positions(azimuth[:, 0], elevation[:, 0], centre)
    corner = start - moved(velocity, time[:, [0, -1]].mean(axis=1), time[:, 0]) + tracks.corner_rad(cache)
    trends = draw_trends(strip_points(cache, corner, tracks.direction, tracks.length_rad), of_trends)
    first, end = block.first, block.end
    add_along_curves(
        data,
        bounds[first:end] - bounds[first, 0],
        tracks=tracks.scans(first, end),
        offsets_rad=_horizon_offsets(setup, pointing),
        amplitude_mk=np.sqrt(b2 / np.sin(elevation[first:end])),
        strips=cache,
        deviates=deviates,
        trends=trends.scans(first, end),
    )


def _layer_velocity(azimuth_rad: np.ndarray, centre_rad: np.ndarray, wind_rad_s: tuple[float, float]) -> np.ndarray:
    """Velocity (n_scan, 2) of the layer in its plane, for scans about elevations `centre_rad` (n_scan,)."""
    middle = np.arctan2(np.sin(azimuth_rad).mean(), np.cos(azimuth_rad).mean())
    return horizon_vector(middle, *wind_rad_s) / np.sin(centre_rad)[:, None]


def _horizon_offsets(setup: Simulation, pointing: Pointing) -> np.ndarray:
    """Offsets (n_det, 2) of the detectors in azimuth (on the sky) and elevation."""
    # At the meridian south of the zenith, azimuth grows to the west.
    east, north = sky_offsets(setup.camera.focal_plane, np.array([pointing.camera_angle_rad]))
    return np.stack([-east[0], north[0]], axis=1)


def moved(velocity_rad_s: np.ndarray, middle_s: np.ndarray, begin_s: np.ndarray) -> np.ndarray:
    """Integrate the velocity (n_scan, 2) of the layer at mid-scan to its displacement at the start of each scan."""
    between = (velocity_rad_s[1:] + velocity_rad_s[:-1]) / 2 * np.diff(middle_s)[:, None]
    until_middle = np.concatenate([np.zeros((1, 2)), np.cumsum(between, axis=0)])
    return until_middle - velocity_rad_s * (middle_s - begin_s)[:, None]
