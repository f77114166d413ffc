"""Measurement of all ladders of a scene."""

from collections.abc import Callable, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.scene import load_scene
from surveysim.studies.convergence.comparison import (
    forecast_row,
    ladder_rows,
    recommendations,
    rms,
    scatter,
    sigmas,
    slopes,
    survey_rows,
)
from surveysim.studies.convergence.records import MOST_SEEDS, REFERENCE_ERROR, SUB_SURVEY, TOLERATED, AccuracyResult
from surveysim.studies.convergence.runs import Task, run_all, seeds_wanted, tasks
from surveysim.studies.convergence.settings import ladders, sub_survey


def measure_accuracy(
    path: Path,
    overrides: Mapping[str, Any] | None = None,
    engine: Engine = SERIAL,
    *,
    reference_error: float = REFERENCE_ERROR,
    seeds: int = MOST_SEEDS,
    observations: int = SUB_SURVEY,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> AccuracyResult:
    """Measure all ladders of a scene, several settings at a time.

    Parameters
    ----------
    reference_error
        Relative error to which the mean of whole surveys is measured.
    seeds
        Largest number of whole surveys.
    observations
        Largest number of observations for the other ladders.
    progress
        Function of the number of finished settings and of all.

    Raises
    ------
    SceneError
        For a scene that cannot be run or has no [score].
    InsufficientDataError
        If the scene's own settings give no score.
    EngineError
        If the engine fails.
    """
    if not 0 < reference_error < 1 or seeds < 1 or observations < 2:
        found = f"{reference_error}, {seeds} and {observations}"
        raise InputError(
            f"reference error, seeds and observations: found {found}; between 0 and 1, 1 and 2 or more are expected"
        )
    start, given = perf_counter(), dict(overrides or {})
    scene = load_scene(path, given)
    if scene.score is None:
        raise SceneError(f"{path}: score: missing; accuracy is that of a score")
    setup = prepare(scene)
    settings, base = ladders(scene, observations), sub_survey(scene, observations)
    whole = Task(scene, tuple(int(item.label) for item in settings if item.kind == "survey"))
    asked = tasks(lambda own: load_scene(path, {**given, **base, **own}), settings)
    n_first = 1 + len(asked.tasks)
    workers = engine.workers_for(n_first)
    first = run_all([whole, *asked.tasks.values()], engine, lambda done: progress(done, n_first))
    wanted = seeds_wanted(scene, first[0], reference_error, seeds)
    others = [Task(load_scene(path, given | {"seed": scene.seed + k}), whole.counts) for k in range(1, wanted)]
    more = run_all(others, engine, lambda done: progress(n_first + done, n_first + len(others)))
    pooled = [run for run in (first[0], *more) if run.scored(scene.observations)]
    rows = survey_rows(settings, pooled)
    rows += ladder_rows(settings, asked, dict(zip(asked.tasks, first[1:], strict=True)))
    sigma, errors = sigmas(run.marks[scene.observations].score for run in pooled)
    reached = rms(errors) / float(np.sqrt(len(pooled)))
    rows.append(forecast_row(setup, settings[-1], float(sigma.mean()), reached))
    return AccuracyResult(
        setup=setup,
        seeds=len(pooled),
        reference_ukcmb2=float(sigma.mean()),
        reference_error=reached,
        wanted_error=reference_error,
        scatter=scatter(sigma) / rms(errors),
        own_error=float(errors[0]),
        sub_observations=base["observations"],
        rows=tuple(rows),
        slopes=tuple(slopes(rows)),
        recommended=tuple(recommendations(rows, TOLERATED * float(errors[0]))),
        wall_s=perf_counter() - start,
        workers=workers,
    )
