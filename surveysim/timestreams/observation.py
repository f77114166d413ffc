"""Time-streams of one observation: all components, through the response of the detectors."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from time import perf_counter

import numpy as np

from mapmaker.geometry import north_angle, plane_directions
from mapmaker.kernels.compiled import compile_s
from mapmaker.lost_samples import fill_flagged
from mapmaker.timestreams import FocalPlane, Timestreams
from surveysim.atmosphere.layers import dominant_layer, dominant_wind
from surveysim.scene.scene import Scene, survey_hash
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.component import StreamComponent, present_components
from surveysim.timestreams.observed_block import ObservedBlock, observation_weather, observed_block
from surveysim.timestreams.response import BlockResponse, block_response
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import Simulation, observation_path
from surveysim.timestreams.time_constants import widen_flags


class Stopwatch:
    """Seconds spent in named stages, without the compilation of kernels, which a process does once."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of the block to `stage`."""
        compiled, start = compile_s(), perf_counter()
        try:
            yield
        finally:
            spent = perf_counter() - start - (compile_s() - compiled)
            self.seconds[stage] = self.seconds.get(stage, 0.0) + spent


def draw_observation(setup: Simulation, observation: int) -> Timestreams:
    """Draw the time-streams of one observation, its blocks side by side; the attributes hold its weather."""
    (_, pointing), watch = observation_path(setup.observing, observation), Stopwatch()
    if len(setup.observing.blocks) == 1:
        return draw_block(setup, observation, pointing, setup.observing.blocks[0], watch).timestreams()
    data, flags = np.empty((setup.camera.n_det, len(pointing.time_s)), setup.stream_type), None
    for block in setup.observing.blocks:
        drawn, samples = draw_block(setup, observation, pointing, block, watch), setup.observing.samples(block)
        data[:, samples] = drawn.data_mk
        if drawn.flags is not None:
            flags = np.empty(data.shape, bool) if flags is None else flags
            flags[:, samples] = drawn.flags
    return _timestreams(setup, observation, pointing, pointing=pointing, first=0, data=data, flags=flags)


@dataclass(frozen=True)
class DrawnBlock:
    """Streams of one block of an observation.

    Attributes
    ----------
    of
        The block.
    data_mk : (n_det, n_samp)
    response
        Response of the detectors, for signals that are simulated alone.
    flags : (n_det, n_samp)
        True for lost samples; None where the scene loses none.
    """

    of: ObservedBlock
    data_mk: np.ndarray
    response: BlockResponse
    flags: np.ndarray | None = None

    @cached_property
    def scan_bounds(self) -> np.ndarray:
        """First and one-past-last sample of each scan, (n_scan, 2)."""
        return self.of.pointing.scan_bounds

    @cached_property
    def lost_scans(self) -> np.ndarray:
        """Scans (n_scan,) bool without a sample of any detector."""
        if self.flags is None:
            return np.zeros(len(self.scan_bounds), bool)
        by_scan = self.flags.reshape(len(self.flags), len(self.scan_bounds), -1)
        return np.asarray(by_scan.all(axis=(0, 2)))

    @cached_property
    def live(self) -> np.ndarray:
        """Detectors (n_det,) bool with a sample in the block."""
        if self.flags is None:
            return np.ones(len(self.data_mk), bool)
        return np.asarray(~self.flags.all(axis=1))

    @property
    def focal_plane(self) -> FocalPlane:
        """Detectors in the array frame."""
        return self.of.setup.camera.focal_plane

    def filled(self, data_mk: np.ndarray) -> np.ndarray:
        """Fill the lost samples of streams (n_det, n_samp) of this block; the streams themselves without flags."""
        return data_mk if self.flags is None else fill_flagged(data_mk, self.scan_bounds, self.flags)

    def timestreams(self) -> Timestreams:
        """Attach directions on the sky and true parameters, which most reductions do without."""
        of = self.of
        pointing, first = of.pointing, of.block.first
        data, flags = self.data_mk, self.flags
        return _timestreams(of.setup, of.observation, of.whole, pointing=pointing, first=first, data=data, flags=flags)


def draw_block(setup: Simulation, observation: int, whole: Pointing, block: Block, watch: Stopwatch) -> DrawnBlock:
    """Draw the time-streams of one block of an observation.

    Parameters
    ----------
    whole
        Pointing of the whole observation.
    watch
        Stopwatch that each component is timed with, under its name.
    """
    of = observed_block(setup, observation, block, whole)
    data, response = _drawn(of, present_components(setup.scene), watch)
    return DrawnBlock(of, data, response, sample_flags(of, watch))


def _drawn(
    of: ObservedBlock, components: Sequence[StreamComponent], watch: Stopwatch
) -> tuple[np.ndarray, BlockResponse]:
    """Draw the streams (n_det, n_samp) of a block: what detectors see, through the response, and noise after it."""
    data = np.zeros((of.setup.camera.n_det, len(of.pointing.time_s)), of.setup.stream_type)
    _add([item for item in components if item.through_response], data, of, watch)
    with watch("response"):
        response = block_response(of, data)
        response.acting_on("signals", "light").apply(data)
    _add([item for item in components if not item.through_response], data, of, watch)
    with watch("response"):
        response.acting_on("streams").apply(data)
    return data, response


def _add(components: Sequence[StreamComponent], data: np.ndarray, of: ObservedBlock, watch: Stopwatch) -> None:
    for item in components:
        if item.add is not None:
            with watch(item.name):
                item.add(data, of)


def sample_flags(of: ObservedBlock, watch: Stopwatch) -> np.ndarray | None:
    """Flags (n_det, n_samp) of the samples of a block that are lost or in turnarounds; None where there are none."""
    present = [item for item in present_components(of.setup.scene) if item.flag is not None]
    lost = np.zeros((of.setup.camera.n_det, len(of.pointing.time_s)), bool) if present else None
    for item in present:
        with watch(item.name):
            item.flag(lost, of)
    if lost is not None:
        widen_flags(of.setup, lost)
    if of.pointing.flagged is None:
        return lost
    turning = np.broadcast_to(of.pointing.flagged, (of.setup.camera.n_det, len(of.pointing.time_s)))
    return turning.copy() if lost is None else lost | turning


def draw_band(setup: Simulation, observation: int, whole: Pointing, block: Block) -> np.ndarray:
    """Draw the streams of another band in one block, without gaps: layer and noise, as a run of that band draws them.

    The sky is left out, because the simulated signals that measure transfer functions are in the mapped band alone.

    Parameters
    ----------
    whole
        Pointing of the whole observation.

    Returns
    -------
    (n_det, n_samp) array [mK]
    """
    of = observed_block(setup, observation, block, whole)
    components = [item for item in present_components(setup.scene) if item.name != "sky"]
    data, response = _drawn(of, components, Stopwatch())
    return DrawnBlock(of, data, response, sample_flags(of, Stopwatch())).filled(data)


@lru_cache(maxsize=2)  # one for all observations
def _survey_hash(scene: Scene) -> str:
    return survey_hash(scene)


def _timestreams(
    setup: Simulation,
    observation: int,
    whole: Pointing,
    *,
    pointing: Pointing,
    first: int,
    data: np.ndarray,
    flags: np.ndarray | None,
) -> Timestreams:
    """Attach pointing and true parameters to streams that begin with the scan `first` of an observation."""
    weather = observation_weather(setup, observation)
    ra, dec = plane_directions(setup.sky.geometry, pointing.xi_rad, pointing.eta_rad)
    truth = {}
    if weather is not None:
        air = setup.scene.atmosphere
        seen = dominant_wind(air, weather)
        truth = {
            "b2_mk2": weather.b2,
            "wind_speed_arcmin_s": np.degrees(seen.wind_speed_rad_s) * 60,
            "wind_angle_deg": np.degrees(seen.wind_angle_rad),
            "layer_height_m": dominant_layer(air).height_m,
        }
    if setup.air.water is not None:
        truth["pwv_mm"] = weather.pwv_mm
    attributes = {
        "scene": setup.scene.name,
        "survey_sha256": _survey_hash(setup.scene),
        "seed": setup.scene.seed,
        "observation": observation,
        "start_mjd_utc": whole.start_mjd,
        "sample_rate_hz": setup.observing.scans.sample_rate_hz,
        "elevation_deg": float(np.degrees(whole.scan_elevation_rad.mean())),
        "camera_angle_deg": float(np.degrees(whole.camera_angle_rad)),
        **truth,
    }
    # Pointing has angles in the tangent plane, a file position angles: they differ by the convergence of meridians.
    north = north_angle(setup.sky.geometry, pointing.xi_rad, pointing.eta_rad)
    angle = pointing.array_angle_rad - north
    plane = setup.camera.focal_plane
    return Timestreams(data, pointing.time_s, ra, dec, angle, first + pointing.scan, plane, attributes, flags)
