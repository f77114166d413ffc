"""Command: optimise."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

from mapmaker.printable import complain
from surveysim.cli import options
from surveysim.cli.interrupts import report_new_start, report_resumable_exit, stopping
from surveysim.cli.options import Force, Kind, NoFigures, Overrides, Quiet, SceneFile, Scheduler, Verbose, Workers, fail
from surveysim.output.names import default_directory

if TYPE_CHECKING:
    from surveysim.studies.optimise.problem import Problem
    from surveysim.studies.optimise.store import EvaluationStore
    from surveysim.studies.sweep.axes import Sweep

EVERY_S = 10.0  # between two lines of progress
MOST_IMPORTANCE = 4096


def optimise(
    scene: SceneFile,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Output directory; by default outputs/<name>_optimise.")
    ] = None,
    forecast: Annotated[bool, typer.Option("--forecast", help="Search by forecast alone: simulate no design.")] = False,
    importance: Annotated[
        int,
        typer.Option(metavar="N", help="Also measure which knob matters, by Sobol' indices of N samples, such as 64."),
    ] = 0,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue from the designs kept in the output.")] = False,
    no_figures: NoFigures = False,
    settings: Overrides = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Search for the best design of a scene by forecast."""
    with_engine = options.engine(engine, workers, scheduler)
    if importance and not (2 <= importance <= MOST_IMPORTANCE and importance & (importance - 1) == 0):
        fail(f"--importance: found {importance}; a power of two from 2 to {MOST_IMPORTANCE} is expected")
    from surveysim.studies.optimise.problem import load_problem

    given = options.settings(settings)
    problem = load_problem(scene, given)
    directory = out or default_directory(f"{problem.scene.name}_optimise", given)
    if resume and not quiet:
        report_new_start(directory, "designs", " design")
    from surveysim.api.optimum import optimise as optimise_scene
    from surveysim.cli.progress import announce_compilation, sweep_display
    from surveysim.report.terminal.optimum import print_optimum

    if not quiet and with_engine.scheduler is None:
        announce_compilation(problem.scene.name)

    def display(sweep: "Sweep") -> AbstractContextManager[Callable[[int], None]]:
        work = [point.detector_samples for point in sweep.points]
        return sweep_display(sweep.name, work, quiet, with_engine.workers_for(len(work)))

    with report_resumable_exit(scene, directory), _search_display(problem, quiet) as progress:
        result = optimise_scene(
            problem,
            directory,
            simulate=not forecast,
            importance=importance,
            engine=with_engine,
            resume=resume,
            figures=not no_figures,
            progress=stopping(progress),
            display=display,
            force=force,
        )
    if not quiet:
        print_optimum(result, directory, verbose)


@contextmanager
def _search_display(problem: "Problem", quiet: bool) -> Iterator[Callable[["EvaluationStore"], None]]:
    """Yield a function that says how many designs were forecast, and the best metrics so far, every few seconds."""
    from surveysim.runtime.numbers import number, plain

    name, said = problem.scene.name, monotonic()

    def show(store: "EvaluationStore") -> None:
        nonlocal said
        if quiet or monotonic() - said < EVERY_S:
            return
        said = monotonic()
        found = [f"{len(store.evaluations)} designs forecast"]
        for key in problem.options.metrics:
            allowed = [item for item in store.evaluations if item.allowed]
            if allowed:
                values = [item.metrics[key] for item in allowed]
                best = min(values) if allowed[0].lower[key] else max(values)
                found.append(f"best {key} = {plain(number(best))}")
        complain(f"{name}: {', '.join(found)}")

    yield show
