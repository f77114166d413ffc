"""The Python interface: a function for each command that computes results, and equal results."""

from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.timestreams import Timestreams
from surveysim.forecasting.forecast import Forecast
from surveysim.forecasting.forecast import forecast as forecast_scene
from surveysim.output.directory import begin, claimed, replacing
from surveysim.output.expected_files import of_forecast, of_run, of_sweep
from surveysim.output.writer import write_forecast, write_outputs, write_sweep
from surveysim.reduction.setup import is_quick, prepare
from surveysim.results.results import SurveyResult, survey_result
from surveysim.results.stopping import StoppingCriteria, check_limits, stopping_rule
from surveysim.runtime.engine import SERIAL, Engine, default_workers
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.scene import Scene, load_scene
from surveysim.scene.shipped import find_scene
from surveysim.studies.resources import Plan, make_plan
from surveysim.studies.sweep.axes import Sweep, is_sweep, load_sweep
from surveysim.studies.sweep.comparison import (
    compare_forecasts,
    compare_runs,
    forecast_points,
    of_one_kind,
    run_points,
)
from surveysim.studies.sweep.plan import SweepPlan, make_sweep_plan
from surveysim.studies.sweep.result import SweepResult
from surveysim.survey.checkpoint import NAME as CHECKPOINT
from surveysim.survey.coadd_tree import CoAddTree
from surveysim.survey.coadds import CoAdds
from surveysim.survey.run import finished_sums, run_observations
from surveysim.timestreams.observation import draw_observation

PROCESSES = Engine()
DRAWS_SEED = 0  # seed for the probability of the best point of a sweep


def simulate_observation(scene: Scene | str | Path, observation: int) -> Timestreams:
    """Simulate the time-streams of one observation.

    Parameters
    ----------
    scene
        A scene, the path of its file, or its name.
    observation
        Number of the observation, from 0.

    Returns
    -------
    Time-streams of all detectors, whole whatever `numerics.max_block_memory` is. Their attributes hold the weather
    that was drawn.

    Raises
    ------
    SceneError
        The scene can't be run.
    InputError
        The scene does not have this observation.
    """
    scene = _scene(scene)
    if not 0 <= observation < scene.observations:
        raise InputError(f"observation: found {observation}; 0 to {scene.observations - 1} is expected")
    with threadpool_limits(1):  # the same bits as in a run
        return draw_observation(prepare(scene), observation)


def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    engine: Engine = PROCESSES,
    resume: bool = False,
    save_timestreams: bool = False,
    figures: bool = True,
    progress: Callable[[CoAddTree], None] = lambda sums: None,
    target_error: float | None = None,
    time_budget_s: float | None = None,
    force: bool = False,
) -> SurveyResult:
    """Simulate, clean, map and score a scene.

    A run that stops early is scored as the whole survey, judged by its first observations. A later run with `resume`
    and other limits, or none, ends with the same bits as a run that never stopped. So does one of the same scene with
    more observations, which reuses those that are finished.

    Parameters
    ----------
    scene
        A scene, the path of its file, or its name.
    out
        Directory for the results, which replace those of an earlier run of the same scene. Its checkpoint.h5 keeps the
        sums over finished observations.
    engine
        Where observations run; results do not depend on it. By default one process per core, but this one for a survey
        of a second or two. Only a dask worker that replaces a lost one imports the calling script, which then needs
        ``if __name__ == "__main__":``.
    resume
        Continue from the checkpoint in `out`.
    save_timestreams
        Write the time-streams of each observation to HDF5 in `out`.
    figures
        Draw the figures of the report.
    progress
        Called with the sums so far after each observation, or after several: their attribute `done` counts the
        observations, their method `so_far()` adds them up.
    target_error
        Stop at this relative error of sigma(A) of the data set "actual", with the forecast as control variate where
        there is one.
    time_budget_s
        Stop after this time [s].
    force
        Replace results of other scenes and commands, unfinished runs, and the user's files of the same names.

    Raises
    ------
    SceneError
        The scene can't be run, or has a table [sweep], which `run_sweep` takes.
    InputError
        A limit makes no sense, or time-streams are to be saved without `out`.
    OutputError
        Another job writes to `out`, or `out` holds other files; FinishedError where there is nothing to resume.
    CheckpointError
        The checkpoint does not belong to the scene.
    EngineError
        The engine can't go on.
    """
    start, limits = perf_counter(), StoppingCriteria(target_error, time_budget_s)
    setup = prepare(_scene(scene))
    check_limits(setup, limits)
    engine = engine.for_work(is_quick(setup))
    workers = engine.workers_for(setup.scene.observations)
    if save_timestreams and out is None:
        raise InputError("save_timestreams: found no output directory; one is expected")

    def result_of(checkpoint: Path | None, streams: Path | None, nodes: Sequence[CoAdds] = ()) -> SurveyResult:
        stops = stopping_rule(setup, limits, start)
        coadds = run_observations(
            setup, checkpoint, engine, nodes=nodes, keep=True, timestream_dir=streams, progress=progress, stops=stops
        )
        return survey_result(
            setup, coadds, wall_s=perf_counter() - start, workers=workers, limits=limits, engine=engine.kind
        )

    if out is None:
        return result_of(None, None)
    with claimed(Path(out), of_run(setup, figures, save_timestreams), force, resume) as place:
        checkpoint, streams = place.path / CHECKPOINT, place.path / "timestreams" if save_timestreams else None
        nodes = finished_sums(setup, checkpoint, streams) if resume else []  # or an error, before anything is changed
        begin(place, removed=lambda name: force)
        result = result_of(checkpoint, streams, nodes)
        whole = result.coadds.done == setup.scene.observations
        with replacing(place, whole=whole) as new:
            numbers = range(result.coadds.done) if save_timestreams else ()
            names = [f"timestreams/{number:04d}.h5" for number in numbers]
            # None of before a resumption that asked for them.
            write_outputs(new, result, figures, [name for name in names if (place.path / name).is_file()])
    return result


def forecast(scene: Scene | str | Path, out: str | Path | None = None, *, force: bool = False) -> Forecast:
    """Forecast the scores of a scene without a Monte Carlo.

    Parameters
    ----------
    scene
        A scene, the path of its file, or its name.
    out
        Directory for the results.
    force
        Replace other results in `out`, and the user's files of the same names.

    Returns
    -------
    Forecasts of all data sets that can be forecast.

    Raises
    ------
    SceneError
        The scene can't be run, or has a table [sweep], which `forecast_sweep` takes.
    NotForecastableError
        The scene has no [score], or a first cleaning without a forecast.
    OutputError
        As for `run`.
    """
    scene = _scene(scene)
    found = forecast_scene(prepare(scene))
    if out is not None:
        with claimed(Path(out), of_forecast(scene), force) as place, replacing(place) as new:
            write_forecast(new, found)
    return found


def plan(scene: Scene | str | Path, workers: int | None = None, *, start_s: float = 0.0) -> Plan:
    """Predict the cost of a run from a few observations made here.

    Parameters
    ----------
    scene
        A scene, the path of its file, or its name.
    workers
        Worker processes; by default one per core.
    start_s
        CPU time [s] that a process takes to start.

    Returns
    -------
    Stages that run, stages left out with the reasons, run time, memory and size of the output.

    Raises
    ------
    SceneError
        The scene can't be run, or has a table [sweep], which `plan_sweep` takes.
    """
    return make_plan(prepare(_scene(scene)), workers or default_workers(), start_s)


def run_sweep(
    sweep: Sweep | str | Path,
    out: str | Path | None = None,
    *,
    engine: Engine = PROCESSES,
    resume: bool = False,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
    force: bool = False,
) -> SweepResult:
    """Run all points of a sweep and compare them.

    Parameters
    ----------
    sweep
        A sweep, the path of a scene file with a table [sweep], or its name.
    out
        Directory for the results. Finished points are kept in its folder points/ until the results are written.
    engine
        Where points run, one at a time per worker; results do not depend on it.
    resume
        Continue from the points kept in `out`.
    figures
        Draw the figures of the report.
    progress
        Called with the number of finished points.
    force
        As for `run`.

    Raises
    ------
    SceneError
        A point can't be run.
    OutputError, CheckpointError, EngineError
        As for `run`.
    """
    start = perf_counter()
    sweep = _sweep(sweep)
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
            write_sweep(new, prepare(sweep.points[0].scene), result, figures)
    return result


def forecast_sweep(
    sweep: Sweep | str | Path,
    out: str | Path | None = None,
    *,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
    force: bool = False,
) -> SweepResult:
    """Forecast all points of a sweep and compare them, without Monte Carlo errors.

    Parameters, results and errors are those of `run_sweep`.
    """
    start = perf_counter()
    sweep = _sweep(sweep)

    def result_of() -> SweepResult:
        points = forecast_points(sweep, progress)
        comparison = compare_forecasts(points, sweep.reference)
        return SweepResult(sweep, points, comparison, False, perf_counter() - start, 1, SERIAL.kind)

    if out is None:
        return result_of()
    with claimed(Path(out), of_sweep(sweep, "forecast", figures), force) as place:
        result = result_of()
        with replacing(place) as new:
            write_sweep(new, prepare(sweep.points[0].scene), result, figures)
    return result


def plan_sweep(sweep: Sweep | str | Path, workers: int | None = None, *, start_s: float = 0.0) -> SweepPlan:
    """Predict the cost of a sweep from its first and last points.

    Parameters and errors are those of `plan`.
    """
    return make_sweep_plan(_sweep(sweep), workers or default_workers(), start_s)


def _scene(scene: Scene | str | Path) -> Scene:
    """A scene as it is given; SceneError for a file with a table [sweep]."""
    if isinstance(scene, Scene):
        return scene
    if is_sweep(scene):
        raise SceneError(f"{find_scene(scene)}: sweep: found a sweep; a scene without [sweep] is expected")
    return load_scene(scene)


def _sweep(sweep: Sweep | str | Path) -> Sweep:
    return sweep if isinstance(sweep, Sweep) else load_sweep(sweep)
