"""The public functions of scenes and sweeps: each takes those of one band, and those of several."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from surveysim.api.band_sweeps import forecast_band_sweep, run_band_sweep
from surveysim.api.bands import forecast_bands, run_bands
from surveysim.api.forecasts import forecast_survey
from surveysim.api.plans import plan_band_sweep, plan_bands, plan_single_sweep, plan_survey
from surveysim.api.surveys import PROCESSES, run_survey
from surveysim.api.sweeps import forecast_single_sweep, run_single_sweep
from surveysim.forecasting.forecast import Forecast
from surveysim.results.bands import MultiBandForecast, MultiBandResult
from surveysim.results.results import SurveyResult
from surveysim.runtime.engine import Engine
from surveysim.scene.bands import MultiBandScene
from surveysim.scene.kinds import has_bands, is_sweep
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.scene.scene import Scene
from surveysim.studies.resources import Plan
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.band_results import MultiBandSweepResult
from surveysim.studies.sweep.bands import MultiBandSweep
from surveysim.studies.sweep.plan import SweepPlan
from surveysim.studies.sweep.result import SweepResult
from surveysim.studies.sweep.rounds import CONFIDENCE
from surveysim.survey.coadd_tree import CoAddTree


def run(
    scene: Scene | MultiBandScene | str | Path,
    out: str | Path | None = None,
    *,
    engine: Engine = PROCESSES,
    resume: bool = False,
    save_timestreams: bool = False,
    figures: bool = True,
    progress: Callable[[CoAddTree], None] = lambda sums: None,
    target_error: float | None = None,
    target_metric: str = SIGMA_KEY,
    time_budget_s: float | None = None,
    force: bool = False,
) -> SurveyResult | MultiBandResult:
    """Simulate, clean, map and score a scene.

    A run that stops early is scored as the whole survey, judged by its first observations. A later run with `resume`
    and other limits, or none, ends with the same bits as a run that never stopped. So does one of the same scene with
    more observations, which reuses those that are finished.

    Bands of a camera run one after another. The results are those of each band by itself.

    Parameters
    ----------
    scene
        A scene, the path of its file, or its name.
    out
        Directory for the results, which replace those of an earlier run of the same scene. Its checkpoint.h5 keeps the
        sums over finished observations. Each band of a camera has its own, bands/NAME.
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
        Stop at this relative error of the metric of the data set "actual", with the forecast as control variate where
        there is one.
    target_metric
        Key of a quantity, such as "array_net.array_rj"; by default sigma(A).
    time_budget_s
        Stop after this time [s]; bands get equal parts of it.
    force
        Replace results of other scenes and commands, unfinished runs, and the user's files of the same names.

    Returns
    -------
    The result, with the attribute `bands` for a camera of several: results by the name of the band.

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
    work: Callable[..., Any] = run_bands if _is_multi_band(scene) else run_survey
    return work(
        scene,
        out,
        engine=engine,
        resume=resume,
        save_timestreams=save_timestreams,
        figures=figures,
        progress=progress,
        target_error=target_error,
        target_metric=target_metric,
        time_budget_s=time_budget_s,
        force=force,
    )


def forecast(
    scene: Scene | MultiBandScene | str | Path, out: str | Path | None = None, *, force: bool = False
) -> Forecast | MultiBandForecast:
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
    Forecasts of all data sets that can be forecast, with the attribute `bands` for a camera of several bands.

    Raises
    ------
    SceneError
        The scene can't be run, or has a table [sweep], which `forecast_sweep` takes.
    NotForecastableError
        The scene has no [score], or a first cleaning without a forecast, in all bands.
    OutputError
        As for `run`.
    """
    work: Callable[..., Any] = forecast_bands if _is_multi_band(scene) else forecast_survey
    return work(scene, out, force=force)


def plan(
    scene: Scene | MultiBandScene | str | Path, workers: int | None = None, *, start_s: float = 0.0
) -> Plan | dict[str, Plan]:
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
    Stages that run, stages left out with the reasons, run time, memory and size of the output. For a camera of several
    bands the plan of each, by name; they run one after another.

    Raises
    ------
    SceneError
        The scene can't be run, or has a table [sweep], which `plan_sweep` takes.
    """
    work: Callable[..., Any] = plan_bands if _is_multi_band(scene) else plan_survey
    return work(scene, workers, start_s=start_s)


def run_sweep(
    sweep: Sweep | MultiBandSweep | str | Path,
    out: str | Path | None = None,
    *,
    engine: Engine = PROCESSES,
    resume: bool = False,
    figures: bool = True,
    keep_all: bool = False,
    progress: Callable[[int], None] = lambda done: None,
    target_error: float | None = None,
    confidence: float = CONFIDENCE,
    force: bool = False,
) -> SweepResult | MultiBandSweepResult:
    """Run all points of a sweep and compare them.

    With a target error the points run in rounds. After each, only the points that may be the best get more
    observations. Points that stop early are scored as the whole survey, judged by their first observations.

    Parameters
    ----------
    sweep
        A sweep, the path of a scene file with a table [sweep], or its name.
    out
        Directory for the results. Its folder points/ has those of each point: points/3 of point 3.
    engine
        Where points run, one at a time per worker; results do not depend on it.
    resume
        Continue from the points kept in `out`.
    figures
        Draw the figure of the sweep.
    keep_all
        Write maps and figures of each point too.
    progress
        Called with the number of finished points, or with a target error of finished rounds of points.
    target_error
        Stop when the ratio of sigma(A) of each point that may be the best to the best one is known to this relative
        error, or when the best point is known.
    confidence
        Probability from which on the best point is known, over all rounds together.
    force
        As for `run`.

    Returns
    -------
    The result, with the attribute `bands` for a camera of several: results by the name of the band.

    Raises
    ------
    SceneError
        A point can't be run.
    InputError
        A limit makes no sense.
    OutputError, CheckpointError, EngineError
        As for `run`.
    """
    work: Callable[..., Any] = run_band_sweep if _is_multi_band_sweep(sweep) else run_single_sweep
    return work(
        sweep,
        out,
        engine=engine,
        resume=resume,
        figures=figures,
        keep_all=keep_all,
        progress=progress,
        target_error=target_error,
        confidence=confidence,
        force=force,
    )


def forecast_sweep(
    sweep: Sweep | MultiBandSweep | str | Path,
    out: str | Path | None = None,
    *,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
    force: bool = False,
) -> SweepResult | MultiBandSweepResult:
    """Forecast all points of a sweep and compare them, without Monte Carlo errors.

    Parameters, results and errors are those of `run_sweep`.
    """
    work: Callable[..., Any] = forecast_band_sweep if _is_multi_band_sweep(sweep) else forecast_single_sweep
    return work(sweep, out, figures=figures, progress=progress, force=force)


def plan_sweep(
    sweep: Sweep | MultiBandSweep | str | Path, workers: int | None = None, *, start_s: float = 0.0
) -> SweepPlan | dict[str, SweepPlan]:
    """Predict the cost of a sweep from its first and last points.

    Parameters and errors are those of `plan`. For a camera of several bands the result has the plan of each, by name.
    """
    work: Callable[..., Any] = plan_band_sweep if _is_multi_band_sweep(sweep) else plan_single_sweep
    return work(sweep, workers, start_s=start_s)


def _is_multi_band(scene: Scene | MultiBandScene | str | Path) -> bool:
    return isinstance(scene, MultiBandScene) or (not isinstance(scene, Scene) and has_bands(scene))


def _is_multi_band_sweep(sweep: Sweep | MultiBandSweep | str | Path) -> bool:
    return isinstance(sweep, MultiBandSweep) or (not isinstance(sweep, Sweep) and is_sweep(sweep) and has_bands(sweep))
