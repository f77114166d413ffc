"""The Python interface of sweeps of cameras of several bands: the sweep of each band, one after another."""

import json
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from time import perf_counter

from surveysim.api.surveys import PROCESSES
from surveysim.api.sweeps import forecast_single_sweep, run_single_sweep
from surveysim.output.directory import FinishedError, begin, claimed, remove_nested, replacing
from surveysim.output.expected_files import band_directory
from surveysim.output.expected_study_files import of_band_sweep, of_sweep
from surveysim.output.record import Results
from surveysim.output.study_writer import write_band_sweep
from surveysim.runtime.engine import Engine
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.band_results import MultiBandSweepResult
from surveysim.studies.sweep.bands import MultiBandSweep, load_band_sweep
from surveysim.studies.sweep.result import SweepResult
from surveysim.studies.sweep.rounds import CONFIDENCE, SweepLimits
from surveysim.studies.sweep.summary import sweep_summary

Progress = Callable[[int], None]
Display = Callable[[Sweep], AbstractContextManager[Progress]]


def run_band_sweep(
    sweep: MultiBandSweep | str | Path,
    out: str | Path | None = None,
    *,
    engine: Engine = PROCESSES,
    resume: bool = False,
    figures: bool = True,
    keep_all: bool = False,
    progress: Progress = lambda done: None,
    display: Display | None = None,
    target_error: float | None = None,
    confidence: float = CONFIDENCE,
    force: bool = False,
) -> MultiBandSweepResult:
    """Run the sweep of each band; parameters and errors are those of `surveysim.run_sweep`.

    `display` makes the `progress` of one band, for the time of its sweep.
    """

    def work(item: Sweep, directory: Path | None, shown: Progress) -> SweepResult:
        return run_single_sweep(
            item,
            directory,
            engine=engine,
            resume=resume,
            figures=figures,
            keep_all=keep_all,
            progress=shown,
            target_error=target_error,
            confidence=confidence,
            force=force,
        )

    def results(item: Sweep) -> Results:
        return of_sweep(item, "run", figures, None if target_error is None else SweepLimits(target_error, confidence))

    shown = display or (lambda item: nullcontext(progress))
    return _each_band(sweep, out, work, shown, command="run", results=results, resume=resume, force=force)


def forecast_band_sweep(
    sweep: MultiBandSweep | str | Path,
    out: str | Path | None = None,
    *,
    figures: bool = True,
    progress: Progress = lambda done: None,
    display: Display | None = None,
    force: bool = False,
) -> MultiBandSweepResult:
    """Forecast the sweep of each band; parameters and errors are those of `run_band_sweep`."""

    def work(item: Sweep, directory: Path | None, shown: Progress) -> SweepResult:
        return forecast_single_sweep(item, directory, figures=figures, progress=shown, force=force)

    def results(item: Sweep) -> Results:
        return of_sweep(item, "forecast", figures)

    shown = display or (lambda item: nullcontext(progress))
    return _each_band(sweep, out, work, shown, command="forecast", results=results, resume=False, force=force)


def _each_band(
    sweep: MultiBandSweep | str | Path,
    out: str | Path | None,
    work: Callable[[Sweep, Path | None, Progress], SweepResult],
    display: Display,
    *,
    command: str,
    results: Callable[[Sweep], Results],
    resume: bool,
    force: bool,
) -> MultiBandSweepResult:
    start = perf_counter()
    sweep = sweep if isinstance(sweep, MultiBandSweep) else load_band_sweep(sweep)

    def result_of(directory: Path | None) -> MultiBandSweepResult:
        found, summaries = {}, {}
        for name, item in sweep.bands.items():
            place = directory and directory / band_directory(name)
            with display(item) as shown:
                try:
                    found[name] = work(item, place, shown)
                    summaries[name] = sweep_summary(found[name], ())
                except FinishedError:  # in the run that is resumed
                    summaries[name] = json.loads((place / "summary.json").read_text(encoding="utf-8"))
        return MultiBandSweepResult(sweep, found, summaries, perf_counter() - start)

    if out is None:
        return result_of(None)
    with claimed(Path(out), of_band_sweep(sweep, command), force, resume) as place:
        for name, item in sweep.bands.items() if not resume else ():
            with claimed(place.path / band_directory(name), results(item), force):
                pass  # or an error, before any work
        begin(place, removed=lambda name: force)
        if force:
            remove_nested(place.path, sweep.bands)
        result = result_of(place.path)
        with replacing(place) as new:
            write_band_sweep(new, result)
    return result
