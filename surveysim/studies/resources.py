"""Predicted stages, run time, memory and output size of a run, measured on a few observations or one block."""

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import process_time
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from surveysim.reduction.observation import ObservationResult, observe, transfer_functions
from surveysim.reduction.resource_limits import sums_held
from surveysim.reduction.setup import Setup, signal_sim_observations
from surveysim.results.results import survey_result
from surveysim.results.stages import left_out, stages_that_run
from surveysim.runtime.memory import peak_bytes
from surveysim.studies.solution_cost import NO_SOLUTION, solution_cost
from surveysim.survey.coadd_tree import node_bytes, nodes_of_all
from surveysim.survey.coadds import CoAdds, add_observations, empty_coadds, observation_sums
from surveysim.survey.solution import on_scored_patch
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.component import present_components
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.scan_blocks import Block

# Time to draw figures over the start-up time, without and with a score, and the memory of matplotlib.
FIGURE_STARTS, SCORE_FIGURE_STARTS = 2.0, 3.0
FIGURE_BYTES = 80e6
# Memory of Python and the libraries, if the system does not report the memory of a process.
BASE_BYTES = 230e6
# Stages whose time does not depend on the number of scans, and stages of signal simulations.
ONCE, SKIES = ("figure_of_merit", "weights"), ("transfer_function",)


@dataclass(frozen=True)
class Plan:
    """Stages of a run and its predicted cost.

    Attributes
    ----------
    stages, left_out
        What each stage does, and why other stages are left out, by name.
    detector_samples
        Samples of all detectors and observations.
    wall_s, figures_s, solution_s
        Run time on an idle machine [s], and its parts for figures and for maps that are solved for. An iterative map
        takes all its passes.
    memory_bytes
        Memory of the largest process.
    output_bytes, timestream_bytes
        Size of the results, and of the time-streams if they are saved.
    """

    stages: dict[str, str]
    left_out: dict[str, str]
    detector_samples: int
    wall_s: float
    figures_s: float
    solution_s: float
    memory_bytes: float
    output_bytes: float
    timestream_bytes: float


@dataclass(frozen=True)
class _Measured:
    """CPU times [s] and peak memory of this process.

    `first_s` is the extra time of the first observation, `plain_s` and `with_sims_s` the times of an observation
    without and with signal simulations, `adding_s` of co-adding one, `scoring_s` of scoring the sums.
    """

    first_s: float
    plain_s: float
    with_sims_s: float
    adding_s: float
    scoring_s: float
    memory_bytes: float


def make_plan(setup: Setup, workers: int, start_s: float = 0.0) -> Plan:
    """Predict the cost of a run from a few observations, with and without signal simulations, and from scoring them.

    For observations in several blocks, one block and one single scan are simulated.

    Parameters
    ----------
    setup
        The scene, prepared.
    workers
        Worker processes.
    start_s
        CPU time [s] of the start and of preparing `setup`; worker processes take it once more.
    """
    scene = setup.scene
    n_with_sims = int(signal_sim_observations(scene).sum())
    parallel = min(workers, scene.observations, os.cpu_count() or 1)
    with threadpool_limits(1):  # as in a run
        measured = _measure(setup) if len(setup.observing.blocks) == 1 else _measure_block(setup)
    observing_s = (scene.observations - n_with_sims) * measured.plain_s + n_with_sims * measured.with_sims_s
    working_s = (observing_s + scene.observations * measured.adding_s) / parallel
    if scene.map.maker == "iterative":
        working_s *= scene.map.iteration.max_passes
    solution = solution_cost(setup) if scene.map.solved else NO_SOLUTION
    working_s += solution.seconds / parallel
    figures_s = start_s * (SCORE_FIGURE_STARTS if scene.score else FIGURE_STARTS)
    samples = setup.camera.n_det * setup.observing.scans.n_scans * samples_per_scan(setup.observing.scans)
    coadds = empty_coadds(setup.analysis)
    sums, held = node_bytes(setup), sums_held(scene.observations, node_bytes(setup))
    maps = coadds.sums.nbytes + coadds.weight.nbytes + coadds.hits.nbytes
    return Plan(
        stages=stages_that_run(setup),
        left_out=left_out(setup),
        detector_samples=samples * scene.observations,
        wall_s=(1 + (parallel > 1)) * start_s + measured.first_s + working_s + measured.scoring_s + figures_s,
        figures_s=figures_s,
        solution_s=solution.seconds / parallel,
        memory_bytes=measured.memory_bytes + (held - 1) * sums + FIGURE_BYTES + solution.memory_bytes,
        output_bytes=0.6 * maps + 400 * scene.observations + nodes_of_all(setup) * sums,
        timestream_bytes=4.0 * samples * scene.observations,
    )


def _measure(setup: Setup) -> _Measured:
    """Time observations with warm caches; the first one makes the longest strip of the layer."""
    carries = signal_sim_observations(setup.scene)
    plain = int(np.argmin(carries))
    first_s = _timed(observe, setup, _windiest(setup), False)[0] + _timed(observe, setup, plain, False)[0]
    plain_s, result = _timed(observe, setup, plain, False)
    with_sims_s = plain_s
    if carries.any():
        with_sims_s, result = _timed(observe, setup, int(np.argmax(carries)), True)
    return _with_sums(setup, result, max(0.0, first_s - 2 * plain_s), plain_s, with_sims_s)


def _measure_block(setup: Setup) -> _Measured:
    """Time the longest block and a block of one scan with warm caches; extrapolate to a whole observation."""
    carries = signal_sim_observations(setup.scene)
    most = max(block.n_scans for block in setup.observing.blocks)
    block, scan = (_of_one_block(setup, n) for n in (most, 1))
    which = _windiest(setup), bool(carries.any())
    block_s, result = _timed(observe, block, *which)
    if setup.analysis.chooses:
        transfer_functions(scan)  # warm, as all caches are
    scan_s, timed = _timed(observe, scan, *which)
    total = sum(timed.seconds.values())
    once_s, skies_s = (scan_s * sum(timed.seconds.get(name, 0.0) for name in names) / total for names in (ONCE, SKIES))
    with_sims_s = once_s + (scan_s - once_s + _drawn_again_s(setup, timed)) * setup.observing.scans.n_scans
    first_s = max(0.0, block_s - once_s - (scan_s - once_s) * most)
    return _with_sums(setup, result, first_s, with_sims_s - skies_s * setup.observing.scans.n_scans, with_sims_s)


def _drawn_again_s(setup: Setup, scan: ObservationResult) -> float:
    """Time to draw one scan and to measure the wind in it [s], in the pass before wind cleaning; 0 without it."""
    if not setup.analysis.uses_wind:
        return 0.0
    drawing = [item.name for item in present_components(setup.scene)]
    return sum(scan.seconds.get(name, 0.0) for name in (*drawing, "response", "wind"))


def _of_one_block(setup: Setup, n_scans: int) -> Setup:
    """Replace the blocks of a setup by one block of `n_scans` scans."""
    return replace(setup, observing=replace(setup.observing, blocks=(Block(0, 0, n_scans),)))


def _with_sums(
    setup: Setup, result: ObservationResult, first_s: float, plain_s: float, with_sims_s: float
) -> _Measured:
    """Measure the times of co-adding an observation and of scoring the sums."""
    coadds = empty_coadds(setup.analysis)
    for number in range(min(2, setup.scene.observations)):  # once caches are warm, where there is a second
        adding_s, _ = _timed(_add, setup, coadds, replace(result, observation=number))
    scoring_s = _scoring(setup, coadds)
    held = peak_bytes()
    held = BASE_BYTES if math.isnan(held) else held
    return _Measured(first_s, plain_s, with_sims_s, adding_s, scoring_s, held)


def _add(setup: Setup, coadds: CoAdds, result: ObservationResult) -> None:
    add_observations(setup.analysis, coadds, [observation_sums(setup.analysis, result)])


def _scoring(setup: Setup, coadds: CoAdds) -> float:
    """Time to score the sums [s]; it does not depend on the number of observations."""
    if setup.scene.map.solved:
        coadds = on_scored_patch(setup.analysis, coadds)
    return _timed(partial(survey_result, wall_s=0.0, workers=1), setup, coadds)[0] if setup.scene.score else 0.0


def _timed(work: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    # CPU time, which other processes on this machine do not change.
    start = process_time()
    result = work(*arguments)
    return process_time() - start, result


def _windiest(setup: Setup) -> int:
    """Observation with the fastest motion of the layer, hence the longest strip; the first without a layer."""
    if not setup.scene.turbulent:
        return 0
    weathers = [observation_weather(setup, observation) for observation in range(setup.scene.observations)]
    return int(np.argmax([weather.wind_speed_rad_s for weather in weathers]))
