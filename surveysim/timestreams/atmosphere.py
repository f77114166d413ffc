"""The atmosphere: layers that the wind moves through the beams."""

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from mapmaker.geometry import sky_offsets
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Weather, slant_b2
from surveysim.runtime.rng import RandomPurpose
from surveysim.telescope.pointing import Pointing, sky_vector
from surveysim.timestreams.curved_layer import curved_scans
from surveysim.timestreams.layer_views import (
    AzElVector,
    LayerNumbers,
    LayerRealization,
    LayerScans,
    layer_realizations,
    layer_wind,
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
    scans_of = straight_scans if pointing.straight else curved_scans
    for layer in setup.air.layers:
        numbers = LayerNumbers(setup.scene.seed, observation, realization, layer.part)
        wind = layer_wind(layer, weather, pointing, numbers)
        of = scans_of(layer, setup, pointing, wind, b2=b2 * layer.b2_factor)
        for item in layer_realizations(layer, pointing, block, numbers):
            add_realization(data, of, item, block)


def add_realization(data: np.ndarray, of: LayerScans, item: LayerRealization, block: Block) -> None:
    """Add one realization of a layer to the streams of a block."""
    from surveysim.atmosphere.scan_trends import draw_trends

    drawn = slice(block.first, block.end)
    trends = draw_trends(of.points, item.numbers.deviates(RandomPurpose.TREND))
    amplitude, mixed = of.amplitude_mk[drawn], item.weight is not None
    of.add(
        data,
        of.bounds[drawn] - of.bounds[block.first, 0],
        tracks=of.tracks.scans(block.first, block.end),
        amplitude_mk=amplitude.reshape(len(amplitude), -1) * item.weight if mixed else amplitude,
        deviates=item.numbers.deviates(RandomPurpose.ATMOSPHERE, block.number),
        trends=trends.scans(block.first, block.end),
        mean_removed=mixed,
    )


def straight_scans(
    layer: Layer, setup: Simulation, pointing: Pointing, wind_rad_s: AzElVector, *, b2: float
) -> LayerScans:
    """Place straight scans over a layer of some amplitude B2."""
    from surveysim.atmosphere.screen_simulation import add_along_tracks, scan_tracks

    sine = np.sin(pointing.scan_elevation_rad)
    strips = layer.strips.at(float(sine.min()))
    bounds, rate = pointing.scan_bounds, setup.observing.scans.sample_rate_hz
    motion = _layer_motion(setup, pointing, wind_rad_s)
    tracks = scan_tracks(bounds, sample_rate_hz=rate, **motion, strips=strips)
    points = _strip_points(pointing, bounds, motion["layer_velocity_rad_s"], tracks=tracks, strips=strips)
    add = partial(add_along_tracks, sample_rate_hz=rate, strips=strips)
    # Equation 2 of the paper, P = B2 sin(el)^(1 - b) alpha^-b, in angles over sin(el).
    return LayerScans(bounds, tracks, points, np.sqrt(b2 / sine), add)


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
