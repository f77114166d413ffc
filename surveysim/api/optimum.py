"""The Python interface of the search for the best design."""

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from surveysim.api.surveys import PROCESSES
from surveysim.api.sweeps import DRAWS_SEED
from surveysim.output.directory import begin, claimed, remove_nested, replacing
from surveysim.output.expected_study_files import of_optimise
from surveysim.output.study_writer import write_optimum
from surveysim.runtime.engine import Engine
from surveysim.studies.optimise.evaluation import EvaluationJob
from surveysim.studies.optimise.optimum import Found, search_optimum
from surveysim.studies.optimise.problem import Problem, load_problem
from surveysim.studies.optimise.result import OptimiseResult, designs_sweep
from surveysim.studies.optimise.store import FILE, EvaluationStore
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.comparison import compare_runs, of_one_kind, run_points
from surveysim.studies.sweep.result import SweepResult

Display = Callable[[Sweep], AbstractContextManager[Callable[[int], None]]]


def optimise(
    scene: Problem | str | Path,
    out: str | Path | None = None,
    *,
    overrides: Mapping[str, Any] | None = None,
    simulate: bool = True,
    importance: int = 0,
    engine: Engine = PROCESSES,
    resume: bool = False,
    figures: bool = True,
    progress: Callable[[EvaluationStore], None] = lambda store: None,
    display: Display = lambda sweep: nullcontext(lambda done: None),
    force: bool = False,
) -> OptimiseResult:
    """Search for the best design of a scene by forecast, then simulate it and its rivals.

    Parameters
    ----------
    scene
        Path of a scene file with a section [optimise], or its name, or what `load_problem` made of it.
    out
        Directory for the results. Evaluations are kept in its file evaluations.jsonl as they come.
    overrides
        Values by dotted key, as for `load_scene`.
    simulate
        Run the best design, its rivals and the scene as it is, as points of a sweep with paired errors.
    importance
        Samples of Sobol' indices of the knobs, a power of two; 0 leaves them out.
    engine
        Where designs are forecast and simulated; results do not depend on it.
    resume
        Continue from the evaluations, and the points, in `out`.
    figures
        Draw the figures of the report.
    progress
        Called with the evaluations so far after each of them.
    display
        Makes the function that is called with the number of simulated designs, for the time of their simulation.
    force
        As for `run`.

    Returns
    -------
    OptimiseResult
        With the attributes `best` (values by key), `found` and `simulated`, and the methods `table`, `evaluations` and
        `plot`.

    Raises
    ------
    SceneError
        A section, a knob or a metric can't be used, or no design is allowed.
    OutputError, CheckpointError, EngineError
        As for `run`.
    """
    start = perf_counter()
    problem = scene if isinstance(scene, Problem) else load_problem(scene, overrides)

    def result_of(place: Path | None) -> OptimiseResult:
        path = None if place is None else place / FILE
        store = EvaluationStore(problem, EvaluationJob(problem), engine, path=path, progress=progress)
        if resume and path is not None:
            store.resume()
        else:
            store.begin()
        found = search_optimum(store, importance)
        points = None if place is None else place / "points"
        simulated = _simulated(problem, found, points, engine, resume, display) if simulate else None
        workers = engine.workers_for(len(found.designs))
        return OptimiseResult(problem, found, simulated, perf_counter() - start, workers, engine.kind)

    if out is None:
        return result_of(None)
    with claimed(Path(out), of_optimise(problem, figures), force, resume) as place:
        begin(place, removed=lambda name: force)
        if force:
            remove_nested(place.path)
        result = result_of(place.path)
        with replacing(place, over=lambda name: name.startswith("points/"), whole=simulate) as new:
            write_optimum(new, result, figures)
    return result


def _simulated(
    problem: Problem,
    found: Found,
    points: Path | None,
    engine: Engine,
    resume: bool,
    display: Display,
) -> SweepResult:
    """Run the designs of a search and compare them."""
    start, sweep = perf_counter(), designs_sweep(problem, found)
    with display(sweep) as progress:
        results = of_one_kind(run_points(sweep, points, engine, resume, progress))
    with threadpool_limits(1):  # the same bits on any machine
        comparison = compare_runs(results, np.random.default_rng(DRAWS_SEED), sweep.reference, sweep.metric)
    workers = engine.workers_for(len(sweep.points))
    return SweepResult(sweep, results, comparison, True, perf_counter() - start, workers, engine.kind, None)
