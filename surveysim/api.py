"""The Python interface: the same that the command line does."""

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.timestreams import Timestreams
from surveysim.checkpoint import NAME
from surveysim.coadds import CoAdds
from surveysim.engines import SERIAL, Engine
from surveysim.observation import draw_observation
from surveysim.outputs import remove_outputs, remove_partial_files, write_outputs, write_sweep
from surveysim.point_files import remove_points
from surveysim.results import SurveyResult, survey_result
from surveysim.scene import Scene
from surveysim.setup import prepare
from surveysim.stopping import Limits, check_limits, stopping_rule
from surveysim.survey import run_observations
from surveysim.sweep import Sweep, load_sweep
from surveysim.trade import (
    SweepResult,
    compare_forecasts,
    compare_runs,
    forecast_points,
    of_one_kind,
    run_points,
)

PROCESSES = Engine()
DRAWS_SEED = 0  # of the draws that say how sure the best point of a sweep is


def simulate_observation(scene: Scene, observation: int) -> Timestreams:
    """The time-streams of one observation of a scene, the weather drawn for it in their attributes.

    They are whole, whatever `numerics.stream_memory` allows a run. Raises SceneError when the scene can't be run,
    ValueError for an observation that it does not have.
    """
    if not 0 <= observation < scene.observations:
        raise ValueError(f"observation: found {observation}; 0 to {scene.observations - 1} is expected")
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
) -> SurveyResult:
    """Run a scene and, with `out`, write its results there in place of an earlier run's.

    The `engine` is one process a core by default; results do not depend on it. Only a worker of dask that replaces a
    lost one imports the calling script, which then needs ``if __name__ == "__main__":``. With `out`, finished work is
    kept in `out/checkpoint.h5` until the results are written; `resume` goes on from there.

    The run stops early where the relative error of sigma(A) of the actual data, by the forecast as control variate
    if there is one, is no more than `target_error`, or once `time_budget_s` is spent. What is scored is then the whole
    survey, judged by a part of it, and the checkpoint is kept: a later run with `resume` and other limits or none goes
    on and ends with the same bits as one that never stopped. Raises SceneError when the scene can't be run,
    ValueError for limits that make no sense, CheckpointError for a checkpoint that does not belong to the scene and
    EngineError when the engine can't go on.
    """
    start, limits = perf_counter(), Limits(target_error, time_budget_s)
    setup = prepare(scene)
    check_limits(setup, limits)
    workers = engine.workers_for(scene.observations)
    directory = None if out is None else Path(out)
    checkpoint = None if directory is None else directory / NAME
    if save_timestreams and directory is None:
        raise ValueError("save_timestreams: found no output directory; one is expected")
    if directory is not None:
        remove_partial_files(directory)
        if not resume:
            remove_outputs(directory)
    coadds = run_observations(
        setup,
        checkpoint,
        engine=engine,
        resume=resume,
        timestream_dir=directory / "timestreams" if save_timestreams else None,
        progress=progress,
        stops=stopping_rule(setup, limits, start),
    )
    result = survey_result(setup, coadds, perf_counter() - start, workers, limits, engine.kind)
    if directory is not None:
        remove_partial_files(directory)  # of workers that were lost
        if resume:  # until here they were those of a run that was stopped early, if any
            remove_outputs(directory, with_timestreams=not save_timestreams)
        write_outputs(directory, result, figures, save_timestreams)
        if coadds.done == scene.observations:
            checkpoint.unlink(missing_ok=True)
    return result


def run_sweep(
    sweep: Sweep | str | Path,
    out: str | Path | None = None,
    engine: Engine = PROCESSES,
    resume: bool = False,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
) -> SweepResult:
    """Run every point of a sweep (of a scene file with [sweep]) and compare them.

    The workers of the `engine`, one process a core by default, take a point each; results do not depend on them. With
    `out`, results are written there in place of an earlier run's, and what is done is kept in `out/points` until then;
    `resume` goes on from there. `progress` is told how many points are done. Raises SceneError for a point that can't
    be run, CheckpointError for files of other scenes and EngineError when the engine can't go on.
    """
    start = perf_counter()
    sweep = sweep if isinstance(sweep, Sweep) else load_sweep(sweep)
    workers = engine.workers_for(len(sweep.points))
    directory = None if out is None else Path(out)
    kept = None if directory is None else directory / "points"
    if directory is not None:
        remove_partial_files(directory)
        if not resume:
            remove_outputs(directory)
            remove_points(kept)
    points = of_one_kind(run_points(sweep, kept, engine, resume, progress))
    with threadpool_limits(1):  # the same bits on any machine
        comparison = compare_runs(points, np.random.default_rng(DRAWS_SEED), sweep.reference)
    seconds = perf_counter() - start
    result = SweepResult(sweep, points, comparison, True, seconds, workers, engine.kind)
    if directory is not None:
        write_sweep(directory, result, figures)
        remove_points(kept)
    return result


def forecast_sweep(
    sweep: Sweep | str | Path,
    out: str | Path | None = None,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
) -> SweepResult:
    """As `run_sweep`, with forecasts in place of simulations: quick, and without Monte Carlo errors."""
    start = perf_counter()
    sweep = sweep if isinstance(sweep, Sweep) else load_sweep(sweep)
    points = forecast_points(sweep, progress)
    comparison = compare_forecasts(points, sweep.reference)
    result = SweepResult(sweep, points, comparison, False, perf_counter() - start, 1, SERIAL.kind)
    if out is not None:
        remove_outputs(Path(out))
        write_sweep(Path(out), result, figures)
    return result
