"""Commands on surveys: run, forecast, plan."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Annotated, Any

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
    bands_of,
    fail,
    ready_setup,
    sweep_of,
)
from surveysim.cli.sweep_options import (
    point_setup,
    refuse_for_sweep,
    refuse_keep_all,
    refuse_reference,
    sweep_limits,
    sweep_limits_settings,
    sweep_work,
)
from surveysim.output.names import default_directory
from surveysim.runtime.errors import NotForecastableError

if TYPE_CHECKING:
    from surveysim.reduction.setup import Setup
    from surveysim.results.stopping import StoppingCriteria
    from surveysim.runtime.engine import Engine
    from surveysim.studies.sweep.axes import Sweep
    from surveysim.studies.sweep.bands import MultiBandSweep
    from surveysim.studies.sweep.rounds import SweepLimits
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
        str | None,
        typer.Option(
            metavar="ERROR",
            help='Stop at this relative error of sigma(A), or of the ratios of a sweep\'s best points, such as "3%".',
        ),
    ] = None,
    target_metric: Annotated[
        str | None,
        typer.Option(metavar="KEY", help='Metric of the target error of a run, such as "array_net.array_rj".'),
    ] = None,
    confidence: Annotated[
        str | None,
        typer.Option(metavar="SHARE", help='Confidence in the best point of a sweep with a target error; "95%".'),
    ] = None,
    time_budget: Annotated[
        str | None, typer.Option(metavar="TIME", help='Stop after this time, such as "60 s".')
    ] = None,
    reference: Reference = None,
    point: Annotated[
        int | None, typer.Option(metavar="N", help="Run one point of a sweep, by its number, as a run of its own.")
    ] = None,
    keep_all: Annotated[
        bool, typer.Option("--keep-all", help="Write maps and figures of each point of a sweep too.")
    ] = False,
    settings: Overrides = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Simulate, clean, map and score a scene or a sweep."""
    with_engine = options.engine(engine, workers, scheduler)
    refuse_reference(reference, point)
    if target_error is None and options.has_many_observations(scene, settings):
        with_engine.start_early()
    sweep = sweep_of(scene, settings, reference)
    if keep_all:
        refuse_keep_all(scene, point, sweep is not None)
    if sweep and point is None:
        refuse_for_sweep(scene, save_timestreams, time_budget)
        if target_metric is not None:
            fail(f"{scene}: --target-metric: found a sweep; its key 'sweep.metric' is expected")
        of_sweep = sweep_limits(target_error, confidence)
        own = options.settings(settings, reference) | sweep_limits_settings(of_sweep)
        _run_sweep(
            sweep,
            out or default_directory(sweep.name, own),
            of_sweep,
            engine=with_engine,
            resume=resume,
            figures=not no_figures,
            keep_all=keep_all,
            force=force,
            verbose=verbose,
            quiet=quiet,
        )
        return
    if confidence is not None:
        fail(f"{scene}: --confidence: found a run of a scene; a sweep with --target-error is expected")
    limits = options.run_limits(target_error, time_budget, target_metric)
    asked: dict[str, Any] = {"save_timestreams": save_timestreams, "figures": not no_figures, "force": force}
    if point is None and (scenes := bands_of(scene, settings)):
        from surveysim.cli.bands import run_bands

        directory = out or default_directory(scenes.name, options.settings(settings))
        run_bands(scenes, directory, with_engine, limits, resume=resume, verbose=verbose, quiet=quiet, **asked)
        return
    setup = ready_setup(scene, settings) if point is None else point_setup(scene, sweep, point)
    own = {} if point is None else {"point": point}
    directory = out or default_directory(setup.scene.name, options.settings(settings) | own)
    _run_scene(
        scene, setup, with_engine, limits, directory=directory, resume=resume, verbose=verbose, quiet=quiet, **asked
    )


def _run_scene(
    scene: Path,
    setup: "Setup",
    engine: "Engine",
    limits: "StoppingCriteria",
    *,
    directory: Path,
    resume: bool,
    save_timestreams: bool,
    figures: bool,
    force: bool,
    verbose: bool,
    quiet: bool,
) -> None:
    from surveysim.reduction.setup import is_quick

    checked, engine = setup.scene, engine.for_work(is_quick(setup, limits.target_error))
    engine.start_early()
    if limits.target_error is not None and checked.score is None:
        fail(f"{scene}: --target-error: found no [score]; the error is one of a score, which needs it")
    from surveysim.api.surveys import run_survey
    from surveysim.cli.progress import (
        announce_compilation,
        observation_work,
        progress_display,
        score_so_far,
        seconds_left,
        show_solving,
    )

    if resume and not quiet:
        report_new_start(directory, "checkpoint", " observation")
    work, n_workers = observation_work(checked), engine.workers_for(checked.observations)
    if not quiet and engine.scheduler is None:
        announce_compilation(checked.name)
    with (
        report_resumable_exit(scene, directory),
        progress_display(checked.name, work, quiet, workers=n_workers) as show,
    ):

        def shown(sums: "CoAddTree") -> None:
            show(sums.done, lambda: score_so_far(setup, sums), seconds_left(sums, work, n_workers))

        result = run_survey(
            checked,
            directory,
            engine=engine,
            resume=resume,
            save_timestreams=save_timestreams,
            figures=figures,
            progress=stopping(shown),
            solving=stopping(partial(show_solving, checked.name, quiet)),
            target_error=limits.target_error,
            target_metric=limits.metric,
            time_budget_s=limits.time_budget_s,
            force=force,
        )
    if not quiet:
        from surveysim.report.terminal.survey import print_result

        print_result(result, directory, verbose)


def _run_sweep(
    sweep: "Sweep | MultiBandSweep",
    directory: Path,
    limits: "SweepLimits | None",
    *,
    engine: "Engine",
    resume: bool,
    figures: bool,
    keep_all: bool,
    force: bool,
    verbose: bool,
    quiet: bool,
) -> None:
    if resume and not quiet:
        report_new_start(directory, "points", "")
    engine.start_early()
    from surveysim.api.band_sweeps import run_band_sweep
    from surveysim.api.sweeps import run_single_sweep
    from surveysim.cli.progress import announce_compilation, sweep_display
    from surveysim.report.terminal.sweep import print_sweep, print_sweeps
    from surveysim.studies.sweep.axes import Sweep

    if not quiet and engine.scheduler is None:
        announce_compilation(sweep.name)
    options: dict[str, Any] = {"engine": engine, "resume": resume, "figures": figures, "force": force}
    options |= {"keep_all": keep_all, **({} if limits is None else vars(limits))}

    def display(item: "Sweep") -> "AbstractContextManager[Callable[[int], None]]":
        work, what = sweep_work(item, limits is not None)
        return sweep_display(item.name, work, quiet, engine.workers_for(len(item.points)), what)

    with report_resumable_exit(sweep.path, directory):
        if not isinstance(sweep, Sweep):
            results = run_band_sweep(sweep, directory, display=display, **options)
        else:
            with display(sweep) as progress:
                result = run_single_sweep(sweep, directory, progress=progress, **options)
    if not quiet and isinstance(sweep, Sweep):
        print_sweep(result, directory, verbose)
    elif not quiet:
        print_sweeps(results, directory, verbose)


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
    if scenes := bands_of(scene, settings):
        from surveysim.cli.bands import forecast_bands

        forecast_bands(scenes, out, force=force, verbose=verbose, quiet=quiet)
        return
    setup = ready_setup(scene, settings)
    from surveysim.api.forecasts import forecast_survey
    from surveysim.report.terminal.forecast import print_forecast

    try:
        found = forecast_survey(setup.scene, out, force=force)
    except NotForecastableError as error:
        fail(f"{scene}: {error}")
    if not quiet:
        print_forecast(setup, found, verbose)


def _forecast_sweep(
    sweep: "Sweep | MultiBandSweep", directory: Path, *, figures: bool, force: bool, verbose: bool, quiet: bool
) -> None:
    from surveysim.api.band_sweeps import forecast_band_sweep
    from surveysim.api.sweeps import forecast_single_sweep
    from surveysim.cli.progress import equal_work, sweep_display
    from surveysim.report.terminal.sweep import print_sweep, print_sweeps
    from surveysim.studies.sweep.axes import Sweep

    def display(item: "Sweep") -> "AbstractContextManager[Callable[[int], None]]":
        return sweep_display(item.name, equal_work(len(item.points)), quiet)

    if not isinstance(sweep, Sweep):
        results = forecast_band_sweep(sweep, directory, figures=figures, display=display, force=force)
        if not quiet:
            print_sweeps(results, directory, verbose)
        return
    with display(sweep) as progress:
        result = forecast_single_sweep(sweep, directory, figures=figures, progress=progress, force=force)
    if not quiet:
        print_sweep(result, directory, verbose)


def plan(scene: SceneFile, workers: Workers = None, settings: Overrides = None) -> None:
    """Predict run time, memory and disk space of a run."""
    from surveysim.api.plans import plan_band_sweep, plan_bands, plan_single_sweep, plan_survey
    from surveysim.report.terminal.plan import print_band_sweep_plans, print_plan, print_sweep_plan
    from surveysim.runtime.engine import default_workers
    from surveysim.studies.sweep.axes import Sweep

    workers = options.engine("processes", workers, None).workers or default_workers()
    if sweep := sweep_of(scene, settings):
        if isinstance(sweep, Sweep):
            print_sweep_plan(sweep, plan_single_sweep(sweep, workers, start_s=process_time()), workers)
        else:
            print_band_sweep_plans(sweep, plan_band_sweep(sweep, workers, start_s=process_time()), workers)
        return
    if scenes := bands_of(scene, settings):
        from surveysim.report.terminal.bands import print_band_plans

        print_band_plans(scenes, plan_bands(scenes, workers, start_s=process_time()), workers)
        return
    checked = ready_setup(scene, settings).scene
    print_plan(checked, plan_survey(checked, workers, start_s=process_time()), workers)
