"""Time-streams of one observation: all components, through the response of the detectors."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from time import perf_counter

import numpy as np

from mapmaker.geometry import north_angle, plane_directions
from mapmaker.kernels.compiled import compile_s, compile_timer
from mapmaker.timestreams import FocalPlane, Timestreams, scan_bounds
from surveysim.scene.scene import Scene, survey_hash
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.component import StreamComponent, present_components
from surveysim.timestreams.observed_block import ObservedBlock, observation_weather, observed_block
from surveysim.timestreams.response import BlockResponse, block_response
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import Simulation, observation_path


class Stopwatch:
    """Seconds spent in named stages, without the compilation of kernels, which a process does once."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        """Add the time of the block to `stage`."""
        start = perf_counter()
        with compile_timer() as timer:
            try:
                yield
            finally:
                spent = perf_counter() - start - compile_s(timer)
                self.seconds[stage] = self.seconds.get(stage, 0.0) + spent


def draw_observation(setup: Simulation, observation: int) -> Timestreams:
    """Draw the time-streams of one observation, its blocks side by side; the attributes hold its weather."""
    (_, pointing), watch = observation_path(setup.observing, observation), Stopwatch()
    if len(setup.observing.blocks) == 1:
        return draw_block(setup, observation, pointing, setup.observing.blocks[0], watch).timestreams()
    data = np.empty((setup.camera.n_det, len(pointing.time_s)), setup.stream_type)
    for block in setup.observing.blocks:
        data[:, setup.observing.samples(block)] = draw_block(setup, observation, pointing, block, watch).data_mk
    return _timestreams(setup, observation, pointing, pointing=pointing, first=0, data=data)


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
    """

    of: ObservedBlock
    data_mk: np.ndarray
    response: BlockResponse

    @cached_property
    def scan_bounds(self) -> np.ndarray:
        """First and one-past-last sample of each scan, (n_scan, 2)."""
        return scan_bounds(self.of.pointing.scan)

    @property
    def focal_plane(self) -> FocalPlane:
        """Detectors in the array frame."""
        return self.of.setup.camera.focal_plane

    def timestreams(self) -> Timestreams:
        """Attach directions on the sky and true parameters, which most reductions do without."""
        of = self.of
        pointing, first = of.pointing, of.block.first
        return _timestreams(of.setup, of.observation, of.whole, pointing=pointing, first=first, data=self.data_mk)


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
    return _drawn(of, present_components(setup.scene), watch)


def _drawn(of: ObservedBlock, components: Sequence[StreamComponent], watch: Stopwatch) -> DrawnBlock:
    """Draw the streams of a block: what detectors see, through the response, and the noise that they add."""
    data = np.zeros((of.setup.camera.n_det, len(of.pointing.time_s)), of.setup.stream_type)
    _add([item for item in components if item.through_response], data, of, watch)
    with watch("response"):
        response = block_response(of, data)
        response.acting_on("signals", "light").apply(data)
    _add([item for item in components if not item.through_response], data, of, watch)
    with watch("response"):
        response.acting_on("streams").apply(data)
    return DrawnBlock(of, data, response)


def _add(components: Sequence[StreamComponent], data: np.ndarray, of: ObservedBlock, watch: Stopwatch) -> None:
    for item in components:
        with watch(item.name):
            item.add(data, of)


def draw_band(setup: Simulation, observation: int, whole: Pointing, block: Block) -> np.ndarray:
    """Draw the streams of another band in one block: layer and noise, as a run of that band draws them.

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
    return _drawn(of, [item for item in present_components(setup.scene) if item.name != "sky"], Stopwatch()).data_mk


@lru_cache(maxsize=2)  # one for all observations
def _survey_hash(scene: Scene) -> str:
    return survey_hash(scene)


def _timestreams(
    setup: Simulation, observation: int, whole: Pointing, *, pointing: Pointing, first: int, data: np.ndarray
) -> Timestreams:
    """Attach pointing and true parameters to streams that begin with the scan `first` of an observation."""
    weather = observation_weather(setup, observation)
    ra, dec = plane_directions(setup.sky.geometry, pointing.xi_rad, pointing.eta_rad)
    truth = {}
    if weather is not None:
        truth = {
            "b2_mk2": weather.b2,
            "wind_speed_arcmin_s": np.degrees(weather.wind_speed_rad_s) * 60,
            "wind_angle_deg": np.degrees(weather.wind_angle_rad),
            "layer_height_m": setup.scene.atmosphere.layer_height_m,
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
        "elevation_deg": float(np.degrees(whole.elevation_rad.mean())),
        "camera_angle_deg": float(np.degrees(whole.array_angle_rad[0] - whole.parallactic_rad[0])),
        **truth,
    }
    # Pointing has angles in the tangent plane, a file position angles: they differ by the convergence of meridians.
    north = north_angle(setup.sky.geometry, pointing.xi_rad, pointing.eta_rad)
    angle = pointing.array_angle_rad[pointing.scan] - north
    plane = setup.camera.focal_plane
    return Timestreams(data, pointing.time_s, ra, dec, angle, first + pointing.scan, plane, attributes)
