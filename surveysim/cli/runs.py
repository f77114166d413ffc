"""Commands on surveys: run, forecast, plan."""

from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Annotated

import typer

from surveysim.cli import options
from surveysim.cli.interrupts import report_new_start, report_resumable_exit, stopping
from surveysim.cli.options import (
    Force,
    Kind,
    NoFigures,
    Overrides,
    Quiet,
    Reference,
    SceneFile,
    Scheduler,
    Verbose,
    Workers,
    fail,
    ready_setup,
    sweep_of,
)
from surveysim.output.names import default_directory
from surveysim.runtime.errors import NotForecastableError

if TYPE_CHECKING:
    from surveysim.runtime.engine import Engine
    from surveysim.studies.sweep.axes import Sweep
    from surveysim.survey.coadd_tree import CoAddTree


def run(
    scene: SceneFile,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Output directory; by default outputs/<name>+<settings>.")
    ] = None,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the checkpoint in the output.")] = False,
    save_timestreams: Annotated[
        bool, typer.Option("--save-timestreams", help="Write the time-streams of each observation to HDF5.")
    ] = False,
    no_figures: NoFigures = False,
    target_error: Annotated[
        str | None, typer.Option(metavar="ERROR", help='Stop at this relative error of sigma(A), such as "3%".')
    ] = None,
    time_budget: Annotated[
        str | None, typer.Option(metavar="TIME", help='Stop after this time, such as "60 s".')
    ] = None,
    reference: Reference = None,
    settings: Overrides = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Simulate, clean, map and score a scene or a sweep."""
    with_engine = options.engine(engine, workers, scheduler)
    if sweep := sweep_of(scene, settings, reference):
        _refuse_for_sweep(scene, save_timestreams, target_error, time_budget)
        directory = out or default_directory(sweep.name, options.settings(settings, reference))
        _run_sweep(
            sweep,
            directory,
            engine=with_engine,
            resume=resume,
            figures=not no_figures,
            force=force,
            verbose=verbose,
            quiet=quiet,
        )
        return
    from surveysim.reduction.setup import is_quick

    setup = ready_setup(scene, settings)
    checked, with_engine = setup.scene, with_engine.for_work(is_quick(setup))
    with_engine.start_early()
    limits = options.run_limits(target_error, time_budget)
    if limits.target_error is not None and checked.score is None:
        fail(f"{scene}: --target-error: found no [score]; the error is one of sigma(A), which needs it")
    from surveysim.api import run as run_scene
    from surveysim.cli.progress import (
        announce_compilation,
        observation_work,
        progress_display,
        score_so_far,
        seconds_left,
    )
    from surveysim.report.terminal.survey import print_result

    directory = out or default_directory(checked.name, options.settings(settings))
    if resume and not quiet:
        report_new_start(directory, "checkpoint", " observation")
    work, n_workers = observation_work(checked), with_engine.workers_for(checked.observations)
    if not quiet and scheduler is None:
        announce_compilation(checked.name)
    with (
        report_resumable_exit(scene, directory),
        progress_display(checked.name, work, quiet, workers=n_workers) as show,
    ):

        def shown(sums: "CoAddTree") -> None:
            show(sums.done, lambda: score_so_far(setup, sums), seconds_left(sums, work, n_workers))

        result = run_scene(
            checked,
            directory,
            engine=with_engine,
            resume=resume,
            save_timestreams=save_timestreams,
            figures=not no_figures,
            progress=stopping(shown),
            target_error=limits.target_error,
            time_budget_s=limits.time_budget_s,
            force=force,
        )
    if not quiet:
        print_result(result, directory, verbose)


def _refuse_for_sweep(scene: Path, save_timestreams: bool, target_error: str | None, time_budget: str | None) -> None:
    reasons = {
        "--save-timestreams": save_timestreams and "which keeps none",
        "--target-error": target_error is not None and "whose points are run whole",
        "--time-budget": time_budget is not None and "whose points are run whole",
    }
    for option, reason in reasons.items():
        if reason:
            fail(f"{scene}: {option}: found a sweep, {reason}; a scene without [sweep] is expected")


def _run_sweep(
    sweep: "Sweep",
    directory: Path,
    *,
    engine: "Engine",
    resume: bool,
    figures: bool,
    force: bool,
    verbose: bool,
    quiet: bool,
) -> None:
    if resume and not quiet:
        report_new_start(directory, "points", "")
    engine.start_early()
    from surveysim.api import run_sweep
    from surveysim.cli.progress import announce_compilation, progress_display
    from surveysim.report.terminal.sweep import print_sweep

    if not quiet and engine.scheduler is None:
        announce_compilation(sweep.name)
    work = [point.detector_samples for point in sweep.points]
    with (
        report_resumable_exit(sweep.path, directory),
        progress_display(sweep.name, work, quiet, "points", engine.workers_for(len(work))) as show,
    ):
        progress = stopping(lambda done: show(done, lambda: ""))
        result = run_sweep(
            sweep, directory, engine=engine, resume=resume, figures=figures, progress=progress, force=force
        )
    if not quiet:
        print_sweep(result, directory, verbose)


def forecast(
    scene: SceneFile,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Output directory; by default outputs/<name>_forecast for a sweep, else none."
        ),
    ] = None,
    no_figures: NoFigures = False,
    reference: Reference = None,
    settings: Overrides = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Predict the scores of a scene or a sweep within seconds."""
    if sweep := sweep_of(scene, settings, reference):
        directory = out or default_directory(f"{sweep.name}_forecast", options.settings(settings, reference))
        _forecast_sweep(sweep, directory, figures=not no_figures, force=force, verbose=verbose, quiet=quiet)
        return
    setup = ready_setup(scene, settings)
    from surveysim.api import forecast as forecast_scene
    from surveysim.report.terminal.forecast import print_forecast

    try:
        found = forecast_scene(setup.scene, out, force=force)
    except NotForecastableError as error:
        fail(f"{scene}: {error}")
    if not quiet:
        print_forecast(setup, found, verbose)


def _forecast_sweep(sweep: "Sweep", directory: Path, *, figures: bool, force: bool, verbose: bool, quiet: bool) -> None:
    from surveysim.api import forecast_sweep
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.report.terminal.sweep import print_sweep

    with progress_display(sweep.name, equal_work(len(sweep.points)), quiet, "points") as show:
        progress = stopping(lambda done: show(done, lambda: ""))
        result = forecast_sweep(sweep, directory, figures=figures, progress=progress, force=force)
    if not quiet:
        print_sweep(result, directory, verbose)


def plan(scene: SceneFile, workers: Workers = None, settings: Overrides = None) -> None:
    """Predict run time, memory and disk space of a run."""
    from surveysim.api import plan as plan_scene
    from surveysim.api import plan_sweep
    from surveysim.report.terminal.plan import print_plan, print_sweep_plan
    from surveysim.runtime.engine import default_workers

    workers = options.engine("processes", workers, None).workers or default_workers()
    if sweep := sweep_of(scene, settings):
        print_sweep_plan(sweep, plan_sweep(sweep, workers, start_s=process_time()), workers)
        return
    checked = ready_setup(scene, settings).scene
    print_plan(checked, plan_scene(checked, workers, start_s=process_time()), workers)
