"""Command on the stages of a scene: budget."""

from pathlib import Path
from time import process_time
from typing import Annotated, Any

import typer

from surveysim.cli import options
from surveysim.cli.interrupts import report_new_start, report_resumable_exit
from surveysim.cli.options import (
    Force,
    Kind,
    NoFigures,
    Overrides,
    Quiet,
    SceneFile,
    Scheduler,
    Verbose,
    Workers,
    fail,
)
from surveysim.output.names import default_directory
from surveysim.runtime.errors import NotForecastableError


def budget(
    scene: SceneFile,
    metric: Annotated[
        str | None,
        typer.Option(metavar="KEY", help="Quantity that costs are of, such as largest_scale.ell; by default sigma(A)."),
    ] = None,
    forecast: Annotated[bool, typer.Option("--forecast", help="Forecast the points, within seconds.")] = False,
    pairs: Annotated[
        bool, typer.Option("--pairs", help="Measure how each pair of stages interacts too: a point for each.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Output directory; by default outputs/<name>_budget.")
    ] = None,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the points in the output.")] = False,
    no_figures: NoFigures = False,
    settings: Overrides = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Measure what each stage of a scene costs.

    The score with and without each stage, on the same random numbers: removed alone from the whole scene, and added
    alone to the least one.
    """
    from surveysim.scene.metrics import SIGMA_KEY
    from surveysim.studies.budget.points import load_budget

    with_engine = options.engine(engine, workers, scheduler)
    if forecast and resume:
        fail("--resume: found with --forecast, which keeps no points")
    given = options.settings(settings)
    ready = load_budget(scene, given, metric=SIGMA_KEY if metric is None else metric, pairs=pairs)
    kind = "budget_forecast" if forecast else "budget"
    own: dict[str, Any] = {"budget.metric": metric} if metric else {}
    own |= {"budget.pairs": True} if pairs else {}
    directory = out or default_directory(f"{ready.name}_{kind}", given | own)
    if resume and not quiet:
        report_new_start(directory, "points", "")
    if not forecast:
        with_engine.start_early()
    from surveysim.api.budgets import budget as measure
    from surveysim.cli.progress import announce_compilation, equal_work, sweep_display
    from surveysim.output.directory import claimed
    from surveysim.output.expected_study_files import of_budget
    from surveysim.report.terminal.budget import print_budget, print_budget_plan
    from surveysim.studies.sweep.plan import make_sweep_plan

    n_points = len(ready.sweep.points)
    work = equal_work(n_points) if forecast else [point.detector_samples for point in ready.sweep.points]
    n_workers = 1 if forecast else with_engine.workers_for(n_points)
    if not quiet and not forecast and with_engine.scheduler is None:
        results = of_budget(ready, True, not no_figures)
        with report_resumable_exit(scene, directory), claimed(directory, results, force, resume):
            pass  # or an error, before any work
        announce_compilation(ready.name)
        print_budget_plan(ready, make_sweep_plan(ready.sweep, n_workers, process_time()), n_workers)
    with report_resumable_exit(scene, directory), sweep_display(ready.name, work, quiet, n_workers) as progress:
        try:
            result = measure(
                ready,
                directory,
                simulate=not forecast,
                engine=with_engine,
                resume=resume,
                figures=not no_figures,
                progress=progress,
                force=force,
            )
        except NotForecastableError as error:
            fail(f"{scene}: {error}")
    if not quiet:
        print_budget(result, scene, directory, verbose)
