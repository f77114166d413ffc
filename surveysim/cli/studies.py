"""Commands on the simulation itself: accuracy, paper."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mapmaker.printable import complain
from surveysim.cli import options
from surveysim.cli.interrupts import EXIT_FAILED, report_resumable_exit, stopping
from surveysim.cli.options import Force, Kind, NoFigures, Overrides, Quiet, Scheduler, Workers, fail, ready_setup
from surveysim.output.names import default_directory
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.shipped import scene_folder

if TYPE_CHECKING:
    from surveysim.runtime.engine import Engine


LEAST_EXPLAINED = 8  # observations that make quarters of B2


def accuracy(
    scene: Annotated[Path | None, options.SCENE] = None,
    extremes: Annotated[bool, typer.Option("--extremes", help="Run the extreme cases instead.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Output directory; by default outputs/<name>_accuracy.")
    ] = None,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    reference_error: Annotated[
        float,
        typer.Option(metavar="ERROR", help="Relative error of the reference to aim for, from 0.0001 to 0.99."),
    ] = 0.01,
    seeds: Annotated[int, typer.Option(metavar="N", help="Whole surveys to simulate for the reference, at most.")] = 8,
    observations: Annotated[
        int, typer.Option(metavar="N", help="Observations of each survey that measures another setting, 2 or more.")
    ] = 60,
    no_figures: NoFigures = False,
    settings: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Measure how numerical settings change score and run time.

    With --extremes, run cases whose answers are known instead.
    """
    with_engine = options.engine(engine, workers, scheduler)
    if not 1e-4 <= reference_error <= 0.99:
        fail(f"--reference-error: found {reference_error:g}; 0.0001 to 0.99 is expected")
    options.at_least("--seeds", seeds, 1)
    options.at_least("--observations", observations, 2)
    if extremes == (scene is not None):
        fail("accuracy: found both SCENE and --extremes, or none; one of them is expected")
    if extremes:
        if not _run_extremes(out or Path("outputs/extremes"), force, quiet):
            raise typer.Exit(EXIT_FAILED)
        return
    checked = ready_setup(scene, settings).scene
    if checked.score is None:
        fail(f"{scene}: score: missing; accuracy is that of a score")
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.output.directory import claimed, replacing
    from surveysim.output.expected_study_files import accuracy_settings, of_accuracy
    from surveysim.output.study_writer import write_accuracy
    from surveysim.report.terminal.convergence import print_accuracy
    from surveysim.studies.convergence import ladders, measure_accuracy

    given = options.settings(settings)
    own = accuracy_settings(reference_error, seeds, observations)
    directory = out or default_directory(f"{checked.name}_accuracy", given | own)
    most = len(ladders(checked, observations)) + seeds  # equal scenes are run once
    with (
        report_resumable_exit(scene, directory),
        claimed(directory, of_accuracy(checked, own, not no_figures), force) as place,
        progress_display(checked.name, equal_work(most), quiet, "runs") as show,
    ):
        progress = stopping(lambda done, total: show(done, lambda: ""))
        result = measure_accuracy(
            scene,
            given,
            with_engine,
            reference_error=reference_error,
            seeds=seeds,
            observations=observations,
            progress=progress,
        )
        with replacing(place) as new:
            write_accuracy(new, result, not no_figures)
    if not quiet:
        print_accuracy(result, directory)


def _run_extremes(directory: Path, force: bool, quiet: bool) -> bool:
    """Run the stress cases and print their outcomes; return whether all are as expected."""
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.output.directory import claimed, replacing
    from surveysim.output.expected_study_files import EXTREMES
    from surveysim.output.study_writer import write_extremes
    from surveysim.report.terminal.stress import print_extremes
    from surveysim.studies.stress import CASES, run_case

    outcomes = []
    with claimed(directory, EXTREMES, force) as place:
        with progress_display("extremes", equal_work(len(CASES)), quiet, "cases") as show:
            for case in CASES:
                outcomes.append(run_case(case))
                stopping(show)(len(outcomes), lambda: "")
        with replacing(place) as new:
            write_extremes(new / "extremes.ecsv", CASES, outcomes)
    if not quiet:
        print_extremes(CASES, outcomes, directory)
    return all(outcome.ok for outcome in outcomes)


def paper(
    table: Annotated[list[int] | None, typer.Option(metavar="N", help="Number of a table; may be repeated.")] = None,
    figure: Annotated[list[int] | None, typer.Option(metavar="N", help="Number of a figure; may be repeated.")] = None,
    everything: Annotated[bool, typer.Option("--all", help="Make all tables and figures.")] = False,
    explain: Annotated[
        bool, typer.Option("--explain", help="Add ingredients to one frozen layer and compare, instead.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Output directory; by default outputs/paper or outputs/paper_explain."),
    ] = None,
    scenarios: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the scenes; by default scenarios/, or the scenes that ship."),
    ] = None,
    observations: Annotated[
        int | None, typer.Option(metavar="N", help="Observations of each scene, at most, for a quick look.")
    ] = None,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    settings: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Reproduce tables and figures of the paper.

    Published values are given with the simulated ones.
    """
    if observations is not None:
        options.at_least("--observations", observations, 1)
    if explain:
        if table or figure or everything:
            fail("--explain: found with --table, --figure or --all; it stands alone")
        with_engine = options.engine(engine, workers, scheduler)
        _explain(scenarios, out, with_engine, observations=observations, settings=settings, force=force, quiet=quiet)
        return
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.paper.reproduce import reproduce
    from surveysim.paper.scenes import FIGURES, TABLES, wanted

    with_engine = options.engine(engine, workers, scheduler)
    tables = options.numbers("--table", table, TABLES, everything)
    figures = options.numbers("--figure", figure, FIGURES, everything)
    if not tables and not figures:
        fail("nothing asked for: --table, --figure, --all or --explain is expected")
    given = options.settings(settings)
    asked = wanted(tables, figures, scenarios or scene_folder(), observations=observations, overrides=given)
    own = {} if observations is None else {"paper.observations": observations}
    directory = out or default_directory("paper", given | own)
    done = count(1)
    with _reported():
        work = equal_work(asked.observations)
        with progress_display("paper", work, quiet, workers=with_engine.workers_for(len(work))) as show:
            progress = stopping(lambda: show(next(done), lambda: ""))
            written, failed = reproduce(asked, directory, with_engine, progress=progress, force=force)
    if not quiet:
        from surveysim.report.terminal.paper import print_paper

        print_paper(written)
    for line in failed:
        complain(line)
    if failed:
        raise typer.Exit(EXIT_FAILED)


@contextmanager
def _reported() -> Iterator[None]:
    """Report errors of engines and inputs in one line, with exit code 1; errors of scenes pass."""
    from surveysim.runtime.engine import EngineError

    try:
        yield
    except EngineError as error:
        complain(str(error))
        raise typer.Exit(EXIT_FAILED) from None
    except InputError as error:
        if isinstance(error, SceneError):
            raise
        complain(" ".join(str(error).split()))
        raise typer.Exit(EXIT_FAILED) from None


def _explain(
    scenarios: Path | None,
    out: Path | None,
    with_engine: "Engine",
    *,
    observations: int | None,
    settings: list[str] | None,
    force: bool,
    quiet: bool,
) -> None:
    """Run the surveys of all ingredients and print what explains the paper's findings."""
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.paper.explain.ingredients import explained
    from surveysim.paper.explain.run import explain
    from surveysim.report.terminal.paper import print_explanation

    if observations is not None:
        options.at_least("--observations", observations, LEAST_EXPLAINED)
    given = options.settings(settings)
    asked = explained(scenarios or scene_folder(), observations=observations, overrides=given)
    own = {} if observations is None else {"paper.observations": observations}
    directory = out or default_directory("paper_explain", given | own)
    done, work = count(1), equal_work(asked.observations)
    workers = with_engine.workers_for(len(work))
    with _reported(), progress_display("paper --explain", work, quiet, workers=workers) as show:
        progress = stopping(lambda: show(next(done), lambda: ""))
        content = explain(asked, directory, with_engine, progress=progress, force=force)
    if not quiet:
        print_explanation(content, directory)
