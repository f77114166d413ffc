"""Predicted cost of the second stage of maps that are solved for, measured on one block of an observation."""

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
from threadpoolctl import threadpool_limits

from surveysim.reduction.noise_weights import weights_file
from surveysim.reduction.observation import observe
from surveysim.reduction.resource_limits import SOLVED_MAPS
from surveysim.reduction.setup import Setup, signal_sim_observations
from surveysim.survey.solution import add_observed
from surveysim.timestreams.scan_blocks import Block

ITERATIONS = 20.0  # of a map, about: destriped maps of lynx take 17, those of maximum likelihood 10


@dataclass(frozen=True)
class SolutionCost:
    """Time [s] of the second stage on one worker, and the memory of the process that iterates."""

    seconds: float
    memory_bytes: float


NO_SOLUTION = SolutionCost(0.0, 0.0)


def solution_cost(setup: Setup) -> SolutionCost:
    """Predict the cost of solving for the maps, jackknives and signal simulations of a survey."""
    scene, geometry = setup.scene, setup.analysis.geometry
    n_right, n_set = 1 + (scene.score.jackknives if scene.score else 0), len(setup.analysis.data_set_names)
    each_s = _each_s(setup, n_right)
    n_with_sims = int(signal_sim_observations(scene).sum())
    maps_observed = scene.observations * n_set * n_right + n_with_sims * setup.analysis.n_signal_skies
    n_pixel = geometry.n_y * geometry.n_x
    return SolutionCost(ITERATIONS * each_s * maps_observed, 8.0 * SOLVED_MAPS * n_right * n_pixel)


def _each_s(setup: Setup, n_map: int) -> float:
    """Time [s] to apply the normal matrix of an observation to one map, of so many at a time."""
    most = max(block.n_scans for block in setup.observing.blocks)
    one = replace(setup, observing=replace(setup.observing, blocks=(Block(0, 0, most),)))
    skies = np.zeros((n_map, setup.analysis.geometry.n_y * setup.analysis.geometry.n_x), setup.stream_type)
    total = np.zeros(skies.shape)
    with TemporaryDirectory(prefix="surveysim-") as name, threadpool_limits(1):
        observe(one, 0, False, weights_path=weights_file(Path(name), 0))
        for _ in range(2):  # once caches are warm
            start = process_time()
            add_observed(one, Path(name), 0, skies, total)
            taken = process_time() - start
    return taken / n_map * setup.observing.scans.n_scans / most
