"""The Python interface of budgets: run or forecast the points of a scene without its stages."""

from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from surveysim.api.surveys import PROCESSES
from surveysim.api.sweeps import DRAWS_SEED
from surveysim.output.directory import begin, claimed, replacing
from surveysim.output.expected_study_files import of_budget
from surveysim.output.study_writer import write_budget
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import NotForecastableError
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.scene.scene import Scene
from surveysim.studies.budget.exponent import noise_exponent
from surveysim.studies.budget.points import WHOLE, Budget, load_budget
from surveysim.studies.budget.result import BudgetResult
from surveysim.studies.sweep.comparison import (
    compare_forecasts,
    compare_runs,
    forecast_points,
    of_one_kind,
    run_points,
)


def budget(
    scene: Budget | Scene | str | Path,
    out: str | Path | None = None,
    *,
    metric: str = SIGMA_KEY,
    simulate: bool = True,
    pairs: bool = False,
    engine: Engine = PROCESSES,
    resume: bool = False,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
    force: bool = False,
) -> BudgetResult:
    """Measure what each stage of a scene costs: the score with and without it, on the same random numbers.

    Each stage is removed alone from the whole scene, and added alone to the least one: one component of the noise, the
    first of [detector] and [photon] that the scene has. Stages that need others are removed with them and added to
    them: responsivities are fitted to the atmosphere, and all are cleaned.

    Parameters
    ----------
    scene
        A scene of `load_scene`, the path of its file, or its name; or the result of `load_budget`, which has `metric`
        and `pairs`.
    out
        Directory for the results. Finished points are kept in its folder points/ until the results are written.
    metric
        Key of the quantity that costs are of, such as "point_source.depth_mjy"; by default sigma(A).
    simulate
        Run the points; otherwise forecast them, within seconds and without Monte Carlo errors.
    pairs
        Measure the interaction of each pair of stages too, with a point for each pair.
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

    Returns
    -------
    The costs of all stages: ratios of the metric, and survey time as a share of the whole scene's.

    Raises
    ------
    SceneError
        The scene can't be run, is a sweep or has several bands, or has less than two stages.
    NotForecastableError
        A forecast is asked for, and the whole scene has none.
    OutputError, CheckpointError, EngineError
        As for `run`.
    """
    start = perf_counter()
    ready = scene if isinstance(scene, Budget) else load_budget(scene, metric=metric, pairs=pairs)
    sweep, workers = ready.sweep, engine.workers_for(len(ready.sweep.points)) if simulate else 1

    def result_of(kept: Path | None) -> BudgetResult:
        if simulate:
            points = of_one_kind(run_points(sweep, kept, engine, resume, progress))
            with threadpool_limits(1):  # the same bits on any machine
                comparison = compare_runs(points, np.random.default_rng(DRAWS_SEED), WHOLE, sweep.metric)
        else:
            points = forecast_points(sweep, progress)
            if reason := points[WHOLE].unscored:
                raise NotForecastableError(reason)
            comparison = compare_forecasts(points, WHOLE, sweep.metric)
        kind = engine.kind if simulate else SERIAL.kind
        exponent = noise_exponent(sweep, points[WHOLE])
        return BudgetResult(ready, points, comparison, exponent, simulate, perf_counter() - start, workers, kind)

    if out is None:
        return result_of(None)
    with claimed(Path(out), of_budget(ready, simulate, figures), force, resume) as place:
        begin(place, removed=lambda name: force)
        result = result_of(place.path / "points" if simulate else None)
        with replacing(place, over=lambda name: name.startswith("points/")) as new:
            write_budget(new, prepare(sweep.points[WHOLE].scene), result, figures)
    return result
