"""Benchmarks in nanoseconds per detector-sample, and a table of them beside the machine's own floors.

Run with `pytest tests/benchmark`. A timing is reported, never asserted.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from mapmaker.geometry import boresight_pixels
from mapmaker.timestreams import Timestreams
from surveysim.reduction.observation import observe
from surveysim.reduction.observation_result import ObservationResult
from surveysim.reduction.setup import Setup, prepare
from surveysim.scene.scene import load_scene
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import ObservedBlock, observed_block
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import observation_path

OBSERVATION = 0
FLOOR = "floor: normal deviates"
ROUNDS = 30
TIMINGS = pytest.StashKey[dict[str, float]]()


@dataclass(frozen=True)
class Prepared:
    """A scene, one observation of it, and what the first stages hand on to the later ones."""

    setup: Setup
    pointing: Pointing
    streams: Timestreams
    index: np.ndarray  # (n_det, n_samp) pixel of each sample
    result: ObservationResult

    @property
    def block(self) -> Block:
        return self.setup.observing.blocks[0]

    @property
    def observed_block(self) -> ObservedBlock:
        return observed_block(self.setup, OBSERVATION, self.block, self.pointing)

    @property
    def data_mk(self) -> np.ndarray:
        return self.streams.data_mk


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """One BLAS thread, as in a worker of a survey."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="session")
def lynx(pytestconfig) -> Prepared:
    """One observation of the Lynx survey: 115 detectors, 18 scans of 150 samples."""
    setup = prepare(load_scene(pytestconfig.rootpath / "scenarios" / "lynx.toml", {}))
    _, pointing = observation_path(setup.observing, OBSERVATION)
    streams = draw_observation(setup, OBSERVATION)
    angle = pointing.array_angle_rad
    index = boresight_pixels(
        setup.analysis.geometry, pointing.xi_rad, pointing.eta_rad, angle, plane=streams.focal_plane
    )
    result = observe(setup, OBSERVATION, with_signal_sims=True)
    return Prepared(setup, pointing, streams, index, result)


@pytest.fixture
def per_sample(benchmark, lynx, pytestconfig):
    """Time a function without arguments under a name; the median goes to the table and `extra_info`."""

    def time(name, function):
        benchmark.pedantic(function, rounds=ROUNDS, warmup_rounds=2)
        if benchmark.disabled:
            return
        nanoseconds = 1e9 * benchmark.stats.stats.median / lynx.data_mk.size
        benchmark.extra_info["ns_per_detector_sample"] = nanoseconds
        pytestconfig.stash.setdefault(TIMINGS, {})[name] = nanoseconds

    return time


def pytest_terminal_summary(terminalreporter, config):
    timings = config.stash.get(TIMINGS, {})
    if not timings:
        return
    floor = timings.get(FLOOR, np.nan)
    terminalreporter.section("medians per detector-sample, one Lynx observation")
    terminalreporter.write_line(f"{'':<32}{'ns':>9}{'/ deviates':>13}")
    for name, nanoseconds in timings.items():
        terminalreporter.write_line(f"{name:<32}{nanoseconds:9.2f}{nanoseconds / floor:13.2f}")
