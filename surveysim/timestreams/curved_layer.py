"""A layer of the atmosphere in scans whose tracks are curved."""

from functools import partial

import numpy as np

from mapmaker.geometry import sky_offsets
from surveysim.atmosphere.layers import Layer
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.layer_views import AzElVector, LayerScans, mean_azimuth, moved
from surveysim.timestreams.simulation import Simulation


def curved_scans(
    layer: Layer, setup: Simulation, pointing: Pointing, wind_rad_s: AzElVector, *, b2: float
) -> LayerScans:
    """Place scans with curved tracks over a layer of some amplitude B2."""
    from surveysim.atmosphere.curved_tracks import add_along_curves, curved_tracks, horizon_vector, layer_positions
    from surveysim.atmosphere.scan_trends import strip_points

    bounds = pointing.scan_bounds
    azimuth, elevation, time_s = (
        values.reshape(len(bounds), -1) for values in (pointing.azimuth_rad, pointing.elevation_rad, pointing.time_s)
    )
    centre = elevation.mean(axis=1)
    velocity = horizon_vector(mean_azimuth(pointing), *wind_rad_s) / np.sin(centre)[:, None]
    tracks = curved_tracks(
        azimuth_rad=azimuth,
        elevation_rad=elevation,
        time_s=time_s,
        centre_rad=centre,
        layer_velocity_rad_s=velocity,
        radius_rad=layer.strips.half_width_rad,
    )
    strips = layer.strips.at(float(np.sin(centre).min()), float(tracks.half_width_rad.max()))
    start = layer_positions(azimuth[:, 0], elevation[:, 0], centre)
    corner = start - moved(velocity, time_s[:, [0, -1]].mean(axis=1), time_s[:, 0]) + tracks.corner_rad(strips)
    points = strip_points(strips, corner, tracks.direction, tracks.length_rad)
    add = partial(add_along_curves, offsets_rad=_horizon_offsets(setup, pointing), strips=strips)
    return LayerScans(bounds, tracks, points, np.sqrt(b2 / np.sin(elevation)), add)


def _horizon_offsets(setup: Simulation, pointing: Pointing) -> np.ndarray:
    """Offsets (n_det, 2) of the detectors in azimuth (on the sky) and elevation."""
    left, up = sky_offsets(setup.camera.focal_plane, np.array([pointing.camera_angle_rad]))
    return np.stack([-left[0], up[0]], axis=1)  # azimuth grows to the right, position angles to the left
