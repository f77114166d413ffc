"""The Python interface: the same that the command line does."""

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.timestreams import Timestreams
from surveysim.output.directory import begin, claimed, replacing
from surveysim.output.expected_files import of_run, of_sweep
from surveysim.output.writer import write_outputs, write_sweep
from surveysim.reduction.setup import prepare
from surveysim.results.results import SurveyResult, survey_result
from surveysim.results.stopping import StoppingCriteria, check_limits, stopping_rule
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import InputError
from surveysim.scene.scene import Scene
from surveysim.studies.sweep.axes import Sweep, load_sweep
from surveysim.studies.sweep.comparison import compare_forecasts, compare_runs, forecast_points, of_one_kind, run_points
from surveysim.studies.sweep.result import SweepResult
from surveysim.survey.checkpoint import NAME as CHECKPOINT
from surveysim.survey.coadds import CoAdds
from surveysim.survey.run import run_observations
from surveysim.timestreams.observation import draw_observation

PROCESSES = Engine()
DRAWS_SEED = 0  # of the draws that say how sure the best point of a sweep is


def simulate_observation(scene: Scene, observation: int) -> Timestreams:
    """The time-streams of one observation of a scene, the weather drawn for it in their attributes.

    They are whole, whatever `numerics.max_block_memory` allows a run. Raises SceneError when the scene can't be run,
    ValueError for an observation that it does not have.
    """
    if not 0 <= observation < scene.observations:
        raise InputError(f"observation: found {observation}; 0 to {scene.observations - 1} is expected")
    with threadpool_limits(1):  # the same bits as in a run
        return draw_observation(prepare(scene), observation)


def run(
    scene: Scene,
    out: str | Path | None = None,
    engine: Engine = PROCESSES,
    resume: bool = False,
    save_timestreams: bool = False,
    figures: bool = True,
    progress: Callable[[CoAdds], None] = lambda coadds: None,
    target_error: float | None = None,
    time_budget_s: float | None = None,
    force: bool = False,
) -> SurveyResult:
    """Run a scene and, with `out`, write its results there in place of an earlier run's of the same scene.

    The `engine` is one process a core by default; results do not depend on it. Only a worker of dask that replaces a
    lost one imports the calling script, which then needs ``if __name__ == "__main__":``. With `out`, finished work is
    kept in `out/checkpoint.h5` until the results are written; `resume` goes on from there. `force` replaces results of
    other scenes and commands, unfinished runs, and files of the user by names that are to be written.

    The run stops early where the relative error of sigma(A) of the actual data, by the forecast as control variate
    if there is one, is no more than `target_error`, or once `time_budget_s` is spent. What is scored is then the whole
    survey, judged by a part of it, and the checkpoint is kept: a later run with `resume` and other limits or none goes
    on and ends with the same bits as one that never stopped. Raises SceneError when the scene can't be run,
    ValueError for limits that make no sense, OutputError for a directory that another job writes to or that holds
    anything else (FinishedError where there is nothing to resume), CheckpointError for a checkpoint that does not
    belong to the scene and EngineError when the engine can't go on.
    """
    start, limits = perf_counter(), StoppingCriteria(target_error, time_budget_s)
    setup = prepare(scene)
    check_limits(setup, limits)
    workers = engine.workers_for(scene.observations)
    if save_timestreams and out is None:
        raise InputError("save_timestreams: found no output directory; one is expected")

    def result_of(checkpoint: Path | None, streams: Path | None) -> SurveyResult:
        stops = stopping_rule(setup, limits, start)
        coadds = run_observations(setup, checkpoint, engine, resume, streams, progress, stops)
        return survey_result(setup, coadds, perf_counter() - start, workers, limits, engine.kind)

    if out is None:
        return result_of(None, None)
    with claimed(Path(out), of_run(setup, figures, save_timestreams), force, resume) as place:
        begin(place, removed=lambda name: force)
        result = result_of(place.path / CHECKPOINT, place.path / "timestreams" if save_timestreams else None)
        whole = result.coadds.done == scene.observations
        with replacing(place, over=lambda name: whole and name == CHECKPOINT) as new:
            numbers = range(result.coadds.done) if save_timestreams else ()
            streams = [f"timestreams/{number:04d}.h5" for number in numbers]
            # None of before a resumption that asked for them.
            write_outputs(new, result, figures, [name for name in streams if (place.path / name).is_file()])
    return result


def run_sweep(
    sweep: Sweep | str | Path,
    out: str | Path | None = None,
    engine: Engine = PROCESSES,
    resume: bool = False,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
    force: bool = False,
) -> SweepResult:
    """Run every point of a sweep (of a scene file with [sweep]) and compare them.

    The workers of the `engine`, one process a core by default, take a point each; results do not depend on them. With
    `out`, results are written there in place of an earlier run's, and what is done is kept in `out/points` until then;
    `resume` goes on from there. `progress` is told how many points are done, `force` is as in `run`. Raises SceneError
    for a point that can't be run, OutputError as `run`, CheckpointError for files of other scenes and EngineError when
    the engine can't go on.
    """
    start = perf_counter()
    sweep = sweep if isinstance(sweep, Sweep) else load_sweep(sweep)
    workers = engine.workers_for(len(sweep.points))

    def result_of(kept: Path | None) -> SweepResult:
        points = of_one_kind(run_points(sweep, kept, engine, resume, progress))
        with threadpool_limits(1):  # the same bits on any machine
            comparison = compare_runs(points, np.random.default_rng(DRAWS_SEED), sweep.reference)
        return SweepResult(sweep, points, comparison, True, perf_counter() - start, workers, engine.kind)

    if out is None:
        return result_of(None)
    with claimed(Path(out), of_sweep(sweep, "run", figures), force, resume) as place:
        begin(place, removed=lambda name: force)
        result = result_of(place.path / "points")
        with replacing(place, over=lambda name: name.startswith("points/")) as new:
            write_sweep(new, result, figures)
    return result


def forecast_sweep(
    sweep: Sweep | str | Path,
    out: str | Path | None = None,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
    force: bool = False,
) -> SweepResult:
    """As `run_sweep`, with forecasts in place of simulations: quick, and without Monte Carlo errors."""
    start = perf_counter()
    sweep = sweep if isinstance(sweep, Sweep) else load_sweep(sweep)

    def result_of() -> SweepResult:
        points = forecast_points(sweep, progress)
        comparison = compare_forecasts(points, sweep.reference)
        return SweepResult(sweep, points, comparison, False, perf_counter() - start, 1, SERIAL.kind)

    if out is None:
        return result_of()
    with claimed(Path(out), of_sweep(sweep, "forecast", figures), force) as place:
        result = result_of()
        with replacing(place) as new:
            write_sweep(new, result, figures)
    return result
