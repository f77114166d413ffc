"""The time-streams of one observation: atmosphere, other noise and sky, as the detectors see them."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.geometry import north_angle, plane_directions, sky_offsets
from mapmaker.kernels.pixels import add_sky
from mapmaker.timestreams import Timestreams, scan_bounds
from surveysim.atmosphere.weather import Weather, draw_weather
from surveysim.reduction.setup import Setup, observation_path
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.scene import scene_hash
from surveysim.telescope.lattice_noise import CirculantCorrelation, CirculantFactor
from surveysim.telescope.noise_levels import WhiteLevels, white_levels
from surveysim.telescope.pixel_coherence import DenseCorrelation
from surveysim.telescope.pointing import Pointing, sky_vector
from surveysim.telescope.raster import samples_per_scan
from surveysim.timestreams.noise import add_correlated_white, add_excess, add_white, excess_variance
from surveysim.timestreams.scan_blocks import Block

if TYPE_CHECKING:
    from surveysim.atmosphere.scan_trends import ScanTrends
    from surveysim.atmosphere.screen_simulation import StripCache


class Stopwatch:
    """Seconds spent in named stages."""

    def __init__(self):
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of the block to `stage`."""
        start = perf_counter()
        try:
            yield
        finally:
            self.seconds[stage] = self.seconds.get(stage, 0.0) + perf_counter() - start


def draw_observation(setup: Setup, observation: int) -> Timestreams:
    """The time-streams of one observation, its blocks side by side, with the weather drawn for it in the attributes."""
    (_, pointing), watch = observation_path(setup, observation), Stopwatch()
    if len(setup.blocks) == 1:
        return draw_block(setup, observation, pointing, setup.blocks[0], watch)
    data = np.empty((setup.n_det, len(pointing.time_s)), setup.stream_type)
    for block in setup.blocks:
        data[:, setup.samples(block)] = draw_block(setup, observation, pointing, block, watch).data_mk
    return _timestreams(setup, observation, pointing, pointing, 0, data)


def draw_block(setup: Setup, observation: int, whole: Pointing, block: Block, watch: Stopwatch) -> Timestreams:
    """The time-streams of one block of an observation; `whole` points the observation."""
    pointing = whole.scans(block.first, block.end)
    weather = observation_weather(setup, observation)
    data = np.zeros((setup.n_det, len(pointing.time_s)), setup.stream_type)
    with watch("atmosphere"):
        if weather is not None:
            add_layer(setup, observation, whole, weather, data, block=block)
    with watch("excess"):
        _add_excess(setup, observation, block, weather, data)
    with watch("sky"):
        if setup.sky_mk is not None:
            add_sky_signal(setup, pointing, setup.sky_mk, data, np.ones(len(data)))
    # Atmosphere, excess and sky are seen with each detector's own responsivity; the levels of photon and detector
    # noise are those at its output.
    data *= setup.responsivity[:, None].astype(data.dtype)
    levels = _levels(setup, observation, weather)
    with watch("photon"):
        _add_photon(setup, observation, block, levels, data)
    with watch("detector"):
        if setup.scene.detector:
            rng = generator(setup.scene.seed, RandomPurpose.DETECTOR, observation, block=block.number)
            add_white(data, levels.detector_mk2_hz, setup.raster.sample_rate_hz, rng)
    return _timestreams(setup, observation, whole, pointing, block.first, data)


def draw_other_bands(setup: Setup, observation: int, whole: Pointing, block: Block) -> np.ndarray:
    """Streams of the other bands of the same detectors in one block, (n_colour, n_det, n_samp) [mK].

    The same layer as in the mapped band, times what each band makes of the water (section 3.3), and white noise of
    their own. Excess noise and sky are in the mapped band alone. None where no pipeline subtracts other bands. `whole`
    points the observation.
    """
    bands = setup.scene.instrument.bands if setup.subtracts_bands else ()
    n_samp = block.n_scans * samples_per_scan(setup.raster)
    streams = np.zeros((len(bands), setup.n_det, n_samp), setup.stream_type)
    if not bands:
        return streams
    weather = observation_weather(setup, observation)
    layer = np.zeros(streams.shape[1:], streams.dtype)
    add_layer(setup, observation, whole, weather, layer, block=block)
    mapped = setup.water.response(weather.pwv_mm)
    for number, (colour, data) in enumerate(zip(bands, streams, strict=True)):
        scale = np.sqrt(setup.band_waters[number].response(weather.pwv_mm) / mapped)
        data += layer * (scale * setup.band_responsivity[number]).astype(data.dtype)[:, None]
        rng = generator(
            setup.scene.seed, RandomPurpose.DETECTOR, observation, realization=number + 1, block=block.number
        )
        add_white(data, colour.psd_mk2_hz, setup.raster.sample_rate_hz, rng)
    return streams


def observation_weather(setup: Setup, observation: int) -> Weather | None:
    """The weather drawn for one observation; None without an atmosphere."""
    if setup.scene.atmosphere is None:
        return None
    rng = generator(setup.scene.seed, RandomPurpose.WEATHER, observation)
    return draw_weather(setup.scene.atmosphere, setup.water, rng)


def observation_levels(setup: Setup, observation: int) -> WhiteLevels:
    """Photon and detector noise of one observation, in its weather and at its elevation."""
    return _levels(setup, observation, observation_weather(setup, observation))


def _levels(setup: Setup, observation: int, weather: Weather | None) -> WhiteLevels:
    opacity = setup.water.opacity if setup.water else None
    elevation = float(setup.angles.elevation_rad[observation].mean())
    return white_levels(setup.scene, opacity, weather.pwv_mm if weather else np.nan, elevation)


def add_sky_signal(setup: Setup, pointing: Pointing, sky_mk: np.ndarray, data_mk: np.ndarray, gain: np.ndarray) -> None:
    """Add what the detectors see of a sky on the setup's sky grid to the streams, in place.

    Raises ValueError for streams or gains of other samples or detectors than the pointing's and the camera's.
    """
    grid, plane = setup.sky_geometry, setup.camera.focal_plane
    n_det, n_samp = len(plane.x_rad), len(pointing.xi_rad)
    if data_mk.shape != (n_det, n_samp) or gain.shape != (n_det,):
        raise ValueError(
            f"found streams {data_mk.shape}, gains {gain.shape}; ({n_det}, {n_samp}), ({n_det},) are expected"
        )
    scale = 1 / grid.pixel_rad
    angle = pointing.array_angle_rad[pointing.scan]
    column = grid.n_x / 2 - 0.5 - pointing.xi_rad * scale
    row = grid.n_y / 2 - 0.5 + pointing.eta_rad * scale
    cos, sin = np.cos(angle) * scale, np.sin(angle) * scale
    add_sky(data_mk, sky_mk, column, row, cos, sin, plane.x_rad, plane.y_rad, gain.astype(data_mk.dtype))


def add_layer(
    setup: Setup,
    observation: int,
    pointing: Pointing,
    weather: Weather,
    data: np.ndarray,
    realization: int = 0,
    block: Block | None = None,
) -> None:
    """Add one realization of the moving layer in this weather to streams (n_det, n_samp) [mK], in place.

    `pointing` is that of the whole observation: its scans share the layer's trends. Streams are those of one block, or
    of all scans.
    """
    from surveysim.atmosphere.screen_simulation import add_atmosphere

    block = block or Block(0, 0, len(pointing.elevation_rad))
    sine = np.sin(pointing.elevation_rad)
    strips = setup.strips.at(float(sine.min()))
    motion = offsets, velocity, layer_velocity = _layer_motion(setup, pointing, weather)
    trends = _trends(setup, observation, pointing, motion, strips, realization)
    rng = generator(setup.scene.seed, RandomPurpose.ATMOSPHERE, observation, realization, block.number)
    scans = slice(block.first, block.end)
    add_atmosphere(
        data,
        scan_bounds(pointing.scans(block.first, block.end).scan),
        sample_rate_hz=setup.raster.sample_rate_hz,
        offsets_rad=offsets[scans],
        velocity_rad_s=velocity[scans],
        layer_velocity_rad_s=layer_velocity[scans],
        # Equation 2 of the paper, P = B2 sin(el)^(1 - b) alpha^-b, in angles over sin(el).
        amplitude_mk=np.sqrt(weather.b2 / sine[scans]),
        strips=strips,
        rng=rng,
        trends=trends.scans(block.first, block.end),
    )


def _layer_motion(setup: Setup, pointing: Pointing, weather: Weather) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets of the detectors (n_scan, n_det, 2), velocities of boresight and layer (n_scan, 2), over sin(el)."""
    slant = 1 / np.sin(pointing.elevation_rad)[:, None]
    offsets = np.stack(sky_offsets(setup.camera.focal_plane, pointing.array_angle_rad), axis=-1)
    layer = np.stack(sky_vector(pointing.parallactic_rad, *weather.wind_rad_s), axis=-1)
    return offsets * slant[:, None], pointing.velocity_rad_s * slant, layer * slant


def _trends(
    setup: Setup,
    observation: int,
    pointing: Pointing,
    motion: tuple[np.ndarray, np.ndarray, np.ndarray],
    strips: "StripCache",
    realization: int,
) -> "ScanTrends":
    """Trends of the layer in all scans of an observation."""
    from surveysim.atmosphere.scan_trends import draw_trends, strip_points
    from surveysim.atmosphere.screen_simulation import scan_tracks

    bounds = scan_bounds(pointing.scan)
    offsets, velocity, layer_velocity = motion
    tracks = scan_tracks(
        bounds,
        sample_rate_hz=setup.raster.sample_rate_hz,
        offsets_rad=offsets,
        velocity_rad_s=velocity,
        layer_velocity_rad_s=layer_velocity,
        strips=strips,
    )
    first, last = bounds[:, 0], bounds[:, 1] - 1
    begin, middle = pointing.time_s[first], (pointing.time_s[first] + pointing.time_s[last]) / 2
    slant = 1 / np.sin(pointing.elevation_rad)[:, None]
    boresight = np.stack([pointing.xi_rad[first], pointing.eta_rad[first]], axis=-1) * slant
    corner = boresight - _moved(layer_velocity, middle, begin) + tracks.corner_rad
    rng = generator(setup.scene.seed, RandomPurpose.TREND, observation, realization)
    return draw_trends(strip_points(strips, corner, tracks.direction, tracks.length_rad), rng)


def _moved(velocity_rad_s: np.ndarray, middle_s: np.ndarray, begin_s: np.ndarray) -> np.ndarray:
    """Way (n_scan, 2) of the layer until each scan begins, from its velocities (n_scan, 2) in the middle of scans."""
    between = (velocity_rad_s[1:] + velocity_rad_s[:-1]) / 2 * np.diff(middle_s)[:, None]
    until_middle = np.concatenate([np.zeros((1, 2)), np.cumsum(between, axis=0)])
    return until_middle - velocity_rad_s * (middle_s - begin_s)[:, None]


def _add_excess(setup: Setup, observation: int, block: Block, weather: Weather | None, data: np.ndarray) -> None:
    section = setup.scene.excess
    if section is None:
        return
    variance = excess_variance(section, None if weather is None else weather.b2)
    rng = generator(setup.scene.seed, RandomPurpose.EXCESS, observation, block=block.number)
    add_excess(data, section, variance, block.n_scans, setup.raster.sample_rate_hz, setup.excess_factor, rng)


def _add_photon(setup: Setup, observation: int, block: Block, levels: WhiteLevels, data: np.ndarray) -> None:
    if setup.scene.photon is None:
        return
    rng = generator(setup.scene.seed, RandomPurpose.PHOTON, observation, block=block.number)
    noise = (data, levels.photon_mk2_hz, setup.raster.sample_rate_hz)
    if setup.photon_overlap is None:
        add_white(*noise, rng)
    else:
        add_correlated_white(*noise, _shared_factor(setup.photon_overlap, levels.shared), rng)


@lru_cache(maxsize=1)  # most scenes have one share for all observations
def _shared_factor(pixels: DenseCorrelation | CirculantCorrelation, share: float) -> np.ndarray | CirculantFactor:
    return pixels.factor(share)


def _timestreams(
    setup: Setup, observation: int, whole: Pointing, pointing: Pointing, first: int, data: np.ndarray
) -> Timestreams:
    """Streams that begin with the scan `first` of an observation, whose truth goes with all of them."""
    weather = observation_weather(setup, observation)
    ra, dec = plane_directions(setup.geometry, pointing.xi_rad, pointing.eta_rad)
    truth = {}
    if weather is not None:
        truth = {
            "b2_mk2": weather.b2,
            "wind_speed_arcmin_s": np.degrees(weather.wind_speed_rad_s) * 60,
            "wind_angle_deg": np.degrees(weather.wind_angle_rad),
            "layer_height_m": setup.scene.atmosphere.layer_height_m,
        }
    if setup.water is not None:
        truth["pwv_mm"] = weather.pwv_mm
    attributes = {
        "scene": setup.scene.name,
        "scene_sha256": scene_hash(setup.scene),
        "seed": setup.scene.seed,
        "observation": observation,
        "start_mjd_utc": whole.start_mjd,
        "sample_rate_hz": setup.raster.sample_rate_hz,
        "elevation_deg": float(np.degrees(whole.elevation_rad.mean())),
        "camera_angle_deg": float(np.degrees(whole.array_angle_rad[0] - whole.parallactic_rad[0])),
        **truth,
    }
    # In the plane within a scan; a file has the position angle at the boresight, which meridians' convergence changes.
    north = north_angle(setup.geometry, pointing.xi_rad, pointing.eta_rad)
    angle = pointing.array_angle_rad[pointing.scan] - north
    plane = setup.camera.focal_plane
    return Timestreams(data, pointing.time_s, ra, dec, angle, first + pointing.scan, plane, attributes)
