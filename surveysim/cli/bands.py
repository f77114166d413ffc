"""Commands on a camera of several bands: progress of each band, and results of all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from surveysim.cli.interrupts import report_new_start, report_resumable_exit, stopping
from surveysim.cli.options import fail
from surveysim.runtime.errors import NotForecastableError

if TYPE_CHECKING:
    from surveysim.api.bands import Progress
    from surveysim.reduction.setup import Setup
    from surveysim.results.stopping import StoppingCriteria
    from surveysim.runtime.engine import Engine
    from surveysim.scene.bands import MultiBandScene
    from surveysim.survey.coadd_tree import CoAddTree


def run_bands(
    scenes: "MultiBandScene",
    directory: Path,
    engine: "Engine",
    limits: "StoppingCriteria",
    *,
    resume: bool,
    save_timestreams: bool,
    figures: bool,
    force: bool,
    verbose: bool,
    quiet: bool,
) -> None:
    """Run all bands and print their results."""
    engine.start_early()
    from surveysim.api.bands import run_bands as run_all
    from surveysim.cli.progress import announce_compilation
    from surveysim.report.terminal.bands import print_bands

    if resume and not quiet:
        report_new_start(directory, "checkpoint", " observation")
    if not quiet and engine.scheduler is None:
        announce_compilation(scenes.name)
    with report_resumable_exit(scenes.path, directory):
        result = run_all(
            scenes,
            directory,
            engine=engine,
            resume=resume,
            save_timestreams=save_timestreams,
            figures=figures,
            display=lambda setup: _display(setup, engine, quiet, limits.target_error),
            target_error=limits.target_error,
            target_metric=limits.metric,
            time_budget_s=limits.time_budget_s,
            force=force,
        )
    if not quiet:
        print_bands(result, directory, verbose)


@contextmanager
def _display(setup: "Setup", engine: "Engine", quiet: bool, target_error: float | None) -> "Iterator[Progress]":
    """Show the progress of one band under its own name."""
    from surveysim.cli.progress import observation_work, progress_display, score_so_far, seconds_left
    from surveysim.reduction.setup import is_quick

    scene = setup.scene
    work, workers = (
        observation_work(scene),
        engine.for_work(is_quick(setup, target_error)).workers_for(scene.observations),
    )
    with progress_display(scene.name, work, quiet, workers=workers) as show:

        def shown(sums: "CoAddTree") -> None:
            show(sums.done, lambda: score_so_far(setup, sums), seconds_left(sums, work, workers))

        yield stopping(shown)


def forecast_bands(
    scenes: "MultiBandScene", directory: Path | None, *, force: bool, verbose: bool, quiet: bool
) -> None:
    """Forecast all bands and print their scores."""
    from surveysim.api.bands import forecast_bands as forecast_all
    from surveysim.report.terminal.bands import print_band_forecasts

    try:
        found = forecast_all(scenes, directory, force=force)
    except NotForecastableError as error:
        fail(f"{scenes.path}: {error}")
    if not quiet:
        print_band_forecasts(found, verbose)
