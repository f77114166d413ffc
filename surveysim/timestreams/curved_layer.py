"""A layer of the atmosphere in scans whose tracks are curved."""

import numpy as np

from mapmaker.geometry import sky_offsets
from mapmaker.timestreams import scan_bounds
from surveysim.atmosphere.curved_tracks import add_along_curves, curved_tracks, horizon_vector, layer_positions
from surveysim.atmosphere.layers import Layer
from surveysim.runtime.rng import RandomPurpose
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.layer_views import LayerNumbers, LayerView, moved
from surveysim.timestreams.simulation import Simulation


def add_curved_layer(
    layer: Layer, setup: Simulation, of: LayerView, *, b2: float, numbers: LayerNumbers, data: np.ndarray
) -> None:
    """Add one realization of a layer of some amplitude B2 to the streams (n_det, n_samp) [mK] of a block, in place."""
    from surveysim.atmosphere.scan_trends import draw_trends, strip_points

    pointing, block, bounds = of.pointing, of.block, scan_bounds(of.pointing.scan)
    azimuth, elevation, time_s = (
        values.reshape(len(bounds), -1) for values in (pointing.azimuth_rad, pointing.elevation_rad, pointing.time_s)
    )
    centre = elevation.mean(axis=1)
    velocity = horizon_vector(of.wind_azimuth_rad, *of.wind_rad_s) / np.sin(centre)[:, None]
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
    trends = draw_trends(points, numbers.deviates(RandomPurpose.TREND))
    amplitude = np.sqrt(b2 / np.sin(elevation[block.first : block.end]))
    add_along_curves(
        data,
        bounds[block.first : block.end] - bounds[block.first, 0] + of.start,
        tracks=tracks.scans(block.first, block.end),
        offsets_rad=_horizon_offsets(setup, pointing),
        amplitude_mk=amplitude if of.weight is None else amplitude * of.weight,
        strips=strips,
        deviates=numbers.deviates(RandomPurpose.ATMOSPHERE, block.number),
        trends=trends.scans(block.first, block.end),
        mean_removed=of.weight is not None,
    )


def _horizon_offsets(setup: Simulation, pointing: Pointing) -> np.ndarray:
    """Offsets (n_det, 2) of the detectors in azimuth (on the sky) and elevation."""
    left, up = sky_offsets(setup.camera.focal_plane, np.array([pointing.camera_angle_rad]))
    return np.stack([-left[0], up[0]], axis=1)  # azimuth grows to the right, position angles to the left
