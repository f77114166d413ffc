"""The Python interface of sweeps: run, forecast and plan one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from threadpoolctl import threadpool_limits

from surveysim.api.surveys import PROCESSES
from surveysim.output.directory import begin, claimed, remove_nested, replacing
from surveysim.output.expected_study_files import of_sweep
from surveysim.output.point_writer import PointWriter, check_points
from surveysim.output.study_writer import write_sweep
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import SERIAL, Engine
from surveysim.studies.sweep.axes import Sweep, load_sweep
from surveysim.studies.sweep.comparison import (
    Comparison,
    compare_forecasts,
    compare_runs,
    forecast_points,
    of_one_kind,
    run_points,
    run_stages,
)
from surveysim.studies.sweep.point_run import Stage
from surveysim.studies.sweep.point_store import PointResult
from surveysim.studies.sweep.result import SweepResult
from surveysim.studies.sweep.rounds import CONFIDENCE, Rounds, SweepLimits, run_rounds

DRAWS_SEED = 0  # seed for the probability of the best point of a sweep


def run_single_sweep(
    sweep: Sweep | str | Path,
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
) -> SweepResult:
    """Run all points of a sweep of one band; parameters and errors are those of `surveysim.run_sweep`."""
    start = perf_counter()
    sweep = sweep_as_given(sweep)
    limits = None if target_error is None else SweepLimits(target_error, confidence)
    work = SweepWork(sweep, limits, engine, resume, progress)

    def result_of(kept: Path | None, writer: PointWriter | None) -> SweepResult:
        points, rounds = work.run(kept, writer)
        points = of_one_kind(points)
        workers = engine.workers_for(len(sweep.points))
        return SweepResult(
            sweep, points, compared(sweep, points), True, perf_counter() - start, workers, engine.kind, rounds
        )

    if out is None:
        return result_of(None, None)
    with claimed(Path(out), of_sweep(sweep, "run", figures, limits), force, resume) as place:
        writer = PointWriter(place.path.absolute(), keep_all, force)
        if not resume:
            check_points(writer, sweep)
        begin(place, removed=lambda name: force)
        if force:
            remove_nested(place.path)
        result = result_of(place.path / "points", writer)
        with replacing(place, over=lambda name: name.startswith("points/")) as new:
            write_sweep(new, prepare(sweep.points[0].scene), result, figures)
    return result


@dataclass(frozen=True)
class SweepWork:
    """The points of a sweep, run whole or in rounds."""

    sweep: Sweep
    limits: SweepLimits | None
    engine: Engine
    resume: bool
    progress: Callable[[int], None]

    def run(self, kept: Path | None, writer: PointWriter | None) -> tuple[tuple[PointResult, ...], Rounds | None]:
        """Run all points, or rounds of them until a limit is reached."""
        if self.limits is None:
            return run_points(self.sweep, kept, self.engine, self.resume, self.progress, writer), None
        done = 0

        def run(stages: Sequence[Stage], begun: bool) -> list[PointResult]:
            nonlocal done
            before, done = done, done + len(stages)
            return run_stages(
                self.sweep,
                stages,
                kept,
                self.engine,
                resume=self.resume,
                begun=begun,
                progress=lambda number: self.progress(before + number),
                keep=writer,
            )

        return run_rounds(self.sweep, self.limits, run, lambda points: compared(self.sweep, of_one_kind(points)))


def compared(sweep: Sweep, points: tuple[PointResult, ...]) -> Comparison:
    """Compare points, with the same bits on any machine."""
    with threadpool_limits(1):
        return compare_runs(points, np.random.default_rng(DRAWS_SEED), sweep.reference, sweep.metric)


def forecast_single_sweep(
    sweep: Sweep | str | Path,
    out: str | Path | None = None,
    *,
    figures: bool = True,
    progress: Callable[[int], None] = lambda done: None,
    force: bool = False,
) -> SweepResult:
    """Forecast all points of a sweep of one band; parameters and errors are those of `surveysim.run_sweep`."""
    start = perf_counter()
    sweep = sweep_as_given(sweep)

    def result_of() -> SweepResult:
        points = forecast_points(sweep, progress)
        comparison = compare_forecasts(points, sweep.reference, sweep.metric)
        return SweepResult(sweep, points, comparison, False, perf_counter() - start, 1, SERIAL.kind, None)

    if out is None:
        return result_of()
    with claimed(Path(out), of_sweep(sweep, "forecast", figures), force) as place:
        result = result_of()
        if force:
            remove_nested(place.path)
        with replacing(place) as new:
            write_sweep(new, prepare(sweep.points[0].scene), result, figures)
    return result


def sweep_as_given(sweep: Sweep | str | Path) -> Sweep:
    """Return a sweep as it is given, or load it."""
    return sweep if isinstance(sweep, Sweep) else load_sweep(sweep)
