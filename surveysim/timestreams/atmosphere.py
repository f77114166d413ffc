"""The atmosphere: layers that the wind moves through the beams."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mapmaker.geometry import sky_offsets
from mapmaker.timestreams import FocalPlane, scan_bounds
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Weather, slant_b2
from surveysim.runtime.rng import RandomPurpose
from surveysim.telescope.pointing import Pointing, sky_vector
from surveysim.timestreams.curved_layer import add_curved_layer
from surveysim.timestreams.layer_views import (
    AzElVector,
    LayerNumbers,
    LayerView,
    evolving_views,
    layer_wind,
    mean_azimuth,
    moved,
)
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import Simulation

if TYPE_CHECKING:
    from surveysim.atmosphere.scan_trends import StripPoints
    from surveysim.atmosphere.screen_simulation import StripCache, Tracks


def add_atmosphere(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the layers of a block to streams (n_det, n_samp), in place."""
    add_layers(of.setup, of.observation, of.whole, weather=of.weather, data=data_mk, block=of.block)


def add_layers(
    setup: Simulation,
    observation: int,
    pointing: Pointing,
    *,
    weather: Weather,
    data: np.ndarray,
    realization: int = 0,
    block: Block | None = None,
) -> None:
    """Add one realization of the moving layers to streams (n_det, n_samp) [mK], in place.

    Parameters
    ----------
    pointing
        Pointing of the whole observation: its scans share the trends of a layer.
    data
        Streams of one block, or of all scans without a `block`.
    realization
        Number of the realization; time-streams have 0.
    """
    b2 = slant_b2(setup.air.water, [weather], [pointing.scan_elevation_rad.mean()])[0]
    block = block or Block(0, 0, len(pointing.scan_elevation_rad))
    for layer in setup.air.layers:
        numbers = LayerNumbers(setup.scene.seed, observation, realization, layer.part)
        of = LayerView(pointing, block, layer_wind(layer, weather, pointing, numbers), mean_azimuth(pointing))
        if layer.section.decorrelation_time_s is None:
            _add_realization(layer, setup, of, b2=b2 * layer.b2_factor, numbers=numbers, data=data)
        for number, view in evolving_views(layer, of, numbers):
            part = replace(numbers, part=f"{layer.part} realization {number}")
            _add_realization(layer, setup, view, b2=b2 * layer.b2_factor, numbers=part, data=data)


def _add_realization(
    layer: Layer, setup: Simulation, of: LayerView, *, b2: float, numbers: LayerNumbers, data: np.ndarray
) -> None:
    """Add one realization of a layer of some amplitude B2 to the streams of a block."""
    add = _add_straight if of.pointing.straight else add_curved_layer
    add(layer, setup, of, b2=b2, numbers=numbers, data=data)


def _add_straight(
    layer: Layer, setup: Simulation, of: LayerView, *, b2: float, numbers: LayerNumbers, data: np.ndarray
) -> None:
    """Add one realization of a layer to the streams of a block of straight scans."""
    from surveysim.atmosphere.scan_trends import draw_trends
    from surveysim.atmosphere.screen_simulation import add_along_tracks, scan_tracks

    pointing, block = of.pointing, of.block
    sine = np.sin(pointing.scan_elevation_rad)
    strips = layer.strips.at(float(sine.min()))
    bounds, rate = scan_bounds(pointing.scan), setup.observing.scans.sample_rate_hz
    motion = _layer_motion(setup, pointing, of.wind_rad_s)
    tracks = scan_tracks(bounds, sample_rate_hz=rate, **motion, strips=strips)
    points = _strip_points(pointing, bounds, motion["layer_velocity_rad_s"], tracks=tracks, strips=strips)
    trends = draw_trends(points, numbers.deviates(RandomPurpose.TREND))
    # Equation 2 of the paper, P = B2 sin(el)^(1 - b) alpha^-b, in angles over sin(el).
    amplitude = np.sqrt(b2 / sine[block.first : block.end])
    add_along_tracks(
        data,
        bounds[block.first : block.end] - bounds[block.first, 0] + of.start,
        sample_rate_hz=rate,
        tracks=tracks.scans(block.first, block.end),
        amplitude_mk=amplitude if of.weight is None else amplitude[:, None] * of.weight,
        strips=strips,
        deviates=numbers.deviates(RandomPurpose.ATMOSPHERE, block.number),
        trends=trends.scans(block.first, block.end),
    )


def _layer_motion(setup: Simulation, pointing: Pointing, wind_rad_s: AzElVector) -> dict[str, Any]:
    """Compute offsets of detectors (n_scan, n_det, 2), velocities of boresight and layer (n_scan, 2), over sin(el)."""
    slant = 1 / np.sin(pointing.scan_elevation_rad)[:, None]

    def offsets(plane: FocalPlane) -> np.ndarray:
        return np.stack(sky_offsets(plane, pointing.scan_array_angle_rad), axis=-1) * slant[:, None]

    layer = np.stack(sky_vector(pointing.scan_parallactic_rad, *wind_rad_s), axis=-1)
    return {
        "offsets_rad": offsets(setup.camera.focal_plane),
        "velocity_rad_s": pointing.velocity_rad_s * slant,
        "layer_velocity_rad_s": layer * slant,
        "extent_rad": None if setup.air.all_bands is None else offsets(setup.air.all_bands),
    }


def _strip_points(
    pointing: Pointing,
    bounds: np.ndarray,
    layer_velocity_rad_s: np.ndarray,
    *,
    tracks: "Tracks",
    strips: "StripCache",
) -> "StripPoints":
    """Place the points of the strips of all scans, with first samples and ends `bounds`, in one frame."""
    from surveysim.atmosphere.scan_trends import strip_points

    first, last = bounds[:, 0], bounds[:, 1] - 1
    begin, middle = pointing.time_s[first], (pointing.time_s[first] + pointing.time_s[last]) / 2
    slant = 1 / np.sin(pointing.scan_elevation_rad)[:, None]
    boresight = np.stack([pointing.xi_rad[first], pointing.eta_rad[first]], axis=-1) * slant
    corner = boresight - moved(layer_velocity_rad_s, middle, begin) + tracks.corner_rad
    return strip_points(strips, corner, tracks.direction, tracks.length_rad)
