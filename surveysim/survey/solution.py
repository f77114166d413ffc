"""Second stage of maps that are solved for: ``(P^T N^-1 P) m = P^T N^-1 d`` over all observations of a survey.

The first stage has added up the right-hand sides and written the noise weights of each observation. Each iteration
points the observations again, applies the normal matrix to all maps at once and adds up in a fixed order: the bits do
not depend on the engine or the number of workers, and memory does not grow with the number of observations.
"""

import os
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.normal_equations import SolveOptions, add_normal, solve_normal
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.data_set import DataSet
from surveysim.reduction.noise_weights import normal_blocks, weights_file
from surveysim.reduction.setup import Setup, prepare, signal_sim_observations
from surveysim.runtime.engine import Engine, unordered_map
from surveysim.scene.scene import Scene
from surveysim.survey.coadds import CoAdds, Convergence, coadd_weights
from surveysim.timestreams.simulation import Angles

CHUNKS = 64  # most parts of a survey whose sums come back from workers
SIGNAL_SIMS = "signal simulations"

Solving = Callable[[str, int], None]  # shows what is solved for, and the number of times the matrix was applied


@dataclass(frozen=True)
class Chunk:
    """Observations of a data set, the weight of each, and the file of the maps (n_right, n_pixel) that they observe.

    Maps are in a file because workers wait for the parent to take their results, and it for them to take its items: of
    small items pipes have room for all.
    """

    data_set: str
    observations: tuple[int, ...]
    weights: tuple[float, ...]
    skies: Path


@dataclass(frozen=True)
class NormalJob:
    """The task of a worker: apply the normal matrix of some observations to maps."""

    scene: Scene
    directory: Path
    angles: Angles | None

    @cached_property
    def setup(self) -> Setup:
        """The scene made ready, once in each worker."""
        setup = prepare(self.scene)
        if self.angles is None:
            return setup
        return replace(setup, observing=replace(setup.observing, known_angles=self.angles))

    def __call__(self, chunk: Chunk) -> np.ndarray:
        """Sum over the observations, (n_right, n_pixel) float64."""
        skies_mk = np.load(chunk.skies)
        total = np.zeros(skies_mk.shape)
        for number, weight in zip(chunk.observations, chunk.weights, strict=True):
            skies = skies_mk * skies_mk.dtype.type(weight)
            add_observed(self.setup, self.directory, number, skies, total, data_set=chunk.data_set)
        return total


def add_observed(
    setup: Setup,
    directory: Path,
    observation: int,
    skies_mk: np.ndarray,
    total: np.ndarray,
    *,
    data_set: str = ACTUAL,
) -> None:
    """Add the normal matrix of an observation, applied to maps (n_right, n_pixel), to `total`, in place."""
    for block in normal_blocks(setup, observation, weights_file(directory, observation), data_set):
        add_normal(block, skies_mk, total)


@dataclass
class _Rounds:
    """Items that are added while a map over them is open."""

    waiting: list[tuple[int, Any]] = field(default_factory=list)
    given: int = 0

    def add(self, items: list[Any]) -> range:
        """Add items; return their numbers."""
        numbers = range(self.given + len(self.waiting), self.given + len(self.waiting) + len(items))
        self.waiting += zip(numbers, items, strict=True)
        return numbers

    def left(self) -> int:
        """Number of items that are not handed out."""
        return len(self.waiting)

    def take(self, workers: int) -> tuple[int, Any] | None:
        """Hand out the next item."""
        if not self.waiting:
            return None
        self.given += 1
        return self.waiting.pop(0)


@dataclass
class _Workers:
    """Workers that stay from one application of the matrix to the next."""

    results: Generator[tuple[int, Any]]
    rounds: _Rounds

    def total(self, chunks: list[Chunk]) -> np.ndarray:
        """Add up the results of chunks in their order."""
        ready: dict[int, np.ndarray] = {}
        total: Any = 0.0
        for number in self.rounds.add(chunks):
            while number not in ready:
                done, result = next(self.results)
                ready[done] = result
            total = total + ready.pop(number)
        return total


@contextmanager
def _workers(setup: Setup, directory: Path, engine: Engine) -> Iterator[_Workers]:
    angles = setup.observing.angles if engine.kind == "processes" else None
    rounds = _Rounds()
    results = unordered_map(NormalJob(setup.scene, directory.absolute(), angles), rounds, engine)
    try:
        yield _Workers(results, rounds)
    finally:
        results.close()


def solved_coadds(setup: Setup, coadds: CoAdds, directory: Path, engine: Engine, progress: Solving) -> CoAdds:
    """Solve for the maps, the jackknives and the signal simulations of the sums over a survey.

    Parameters
    ----------
    coadds
        Right-hand sides over the whole map.
    directory
        Directory of the noise weights of their observations.
    progress
        Called before each application of the normal matrix.

    Returns
    -------
    CoAdds
        Solved maps times their weights; jackknives and signal simulations on the scored patch.
    """
    analysis, signal_maps = setup.analysis, coadds.signal_maps.copy()
    weights = np.array([coadd_weights(analysis, noise) for noise in coadds.noise_mk2()])
    right = np.concatenate([coadds.sums[None], coadds.flipped])
    solved, convergence = np.zeros(right.shape), []
    carry = signal_sim_observations(setup.scene)[: coadds.done]
    with _workers(setup, directory, engine) as workers:
        solve = partial(_solve, setup, directory, workers=workers, progress=progress)
        for s, item in enumerate(analysis.data_sets):
            solved[:, s], found = solve(item, item.name, right[:, s], weights[:, s], coadds.weight[s])
            convergence.append(found)
        for s, item in enumerate(analysis.data_sets):
            carriers = weights[:, s] * carry
            if not (item.own_transfer_function and len(signal_maps) and carriers.any()):
                continue
            # Few observations carry them, which have a normal matrix of their own. Before cleaning they are binned.
            place = analysis.transfer_function_index(item.name)
            name = SIGNAL_SIMS if item.name == ACTUAL else f"{SIGNAL_SIMS} of {item.name}"
            of_carriers = solve(item, name, signal_maps[:, place, 1], carriers, coadds.signal_weight[place])
            signal_maps[:, place, 1] = of_carriers[0]
            convergence.append(of_carriers[1])
    whole = replace(coadds, sums=solved[0], flipped=solved[1:], signal_maps=signal_maps, convergence=tuple(convergence))
    return on_scored_patch(analysis, whole)


def on_scored_patch(analysis: AnalysisSetup, coadds: CoAdds) -> CoAdds:
    """Cut jackknives and signal simulations of the whole map to the scored patch."""
    if analysis.region is None:
        return coadds
    patch = (..., analysis.region.patch, analysis.region.patch)
    flipped, signal_maps, weight = (item[patch] for item in (coadds.flipped, coadds.signal_maps, coadds.signal_weight))
    return replace(coadds, flipped=flipped, signal_maps=signal_maps, signal_weight=weight)


def _solve(
    setup: Setup,
    directory: Path,
    item: DataSet,
    name: str,
    right: np.ndarray,
    weights: np.ndarray,
    diagonal: np.ndarray,
    *,
    workers: _Workers,
    progress: Solving,
) -> tuple[np.ndarray, Convergence]:
    """Solve for maps (n_right, n_y, n_x) of a data set's observations with weights (n_obs,); return maps times weights.

    `name` is what is solved for.
    """
    used = np.flatnonzero(weights)
    parts = [part for part in np.array_split(used, min(CHUNKS, max(1, len(used)))) if len(part)]
    applied, own = 0, item.pipeline.data_set

    def apply(skies_mk: np.ndarray) -> np.ndarray:
        nonlocal applied
        progress(name, applied)
        applied += 1
        path = directory.absolute() / f"skies_{applied}.npy.{os.getpid()}.part"
        try:
            with open(path, "wb") as file:
                np.save(file, skies_mk.astype(setup.stream_type))
            chunks = [Chunk(own, tuple(part.tolist()), tuple(weights[part].tolist()), path) for part in parts]
            return workers.total(chunks)
        finally:
            path.unlink(missing_ok=True)

    section = setup.scene.map.solver
    options = SolveOptions(section.tolerance, section.max_iterations)
    found = solve_normal(apply, right.reshape(len(right), -1), diagonal, options=options)
    convergence = Convergence(name, found.iterations, float(found.residual.max()), bool(found.converged.all()))
    return found.sky_mk.reshape(right.shape) * diagonal, convergence
