"""The command line: run, forecast, accuracy, plan, paper, report, check, new."""

import re
from itertools import count
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer

from surveysim.cli import options
from surveysim.cli.interrupts import EXIT_FAILED, report_new_start, report_resumable_exit, stopping
from surveysim.cli.options import Force, Kind, NoFigures, Overrides, Quiet, Reference, SceneFile, Scheduler, Workers
from surveysim.output.names import default_directory
from surveysim.runtime.printable import complain, say
from surveysim.scene.scene import MAX_NAME, NAME, Scene, SceneError, load_scene, read_scene
from surveysim.scene.units import shown

if TYPE_CHECKING:
    from surveysim.runtime.engine import Engine
    from surveysim.studies.sweep.axes import Sweep

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Monte Carlo surveys of millimetre-wave cameras through a turbulent atmosphere.",
)


@app.command()
def run(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="where results go; outputs/<name>+<settings> by default")] = None,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on from the checkpoint in the output")] = False,
    save_timestreams: Annotated[
        bool, typer.Option("--save-timestreams", help="write every observation to HDF5")
    ] = False,
    no_figures: NoFigures = False,
    target_error: Annotated[
        str | None, typer.Option(metavar="ERROR", help='stop at this relative error of sigma(A), e.g. "3%"')
    ] = None,
    time_budget: Annotated[
        str | None, typer.Option(metavar="TIME", help='stop simulating after this time, e.g. "60 s"')
    ] = None,
    reference: Reference = None,
    settings: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Simulate, clean, map and score a scene, or every point of its sweep."""
    with_engine = options.engine(engine, workers, scheduler)
    if sweep := _sweep(scene, settings, reference):
        _refuse_for_sweep(scene, save_timestreams, target_error, time_budget)
        directory = out or default_directory(sweep.name, options.settings(settings, reference))
        _run_sweep(sweep, directory, with_engine, resume, not no_figures, force, quiet)
        return
    limits = options.run_limits(target_error, time_budget)
    checked = _ready(scene, settings)
    if limits.target_error is not None and checked.score is None:
        _fail(f"{scene}: --target-error: found no [score]; the error is one of sigma(A), which needs it")
    from surveysim.api import run as run_scene
    from surveysim.cli.progress import equal_work, progress_display, score_so_far
    from surveysim.report.terminal.survey import print_result

    directory = out or default_directory(checked.name, options.settings(settings))
    if resume and not quiet:
        report_new_start(directory, "checkpoint", " observation")
    work = equal_work(checked.observations)
    with (
        report_resumable_exit(scene, directory),
        progress_display(checked.name, work, quiet, workers=with_engine.workers_for(len(work))) as show,
    ):
        progress = stopping(lambda coadds: show(coadds.done, lambda: score_so_far(checked, coadds)))
        todo = (checked, directory, with_engine, resume, save_timestreams, not no_figures, progress)
        result = run_scene(*todo, limits.target_error, limits.time_budget_s, force)
    if not quiet:
        print_result(result, directory)


def _refuse_for_sweep(scene: Path, save_timestreams: bool, target_error: str | None, time_budget: str | None) -> None:
    reasons = {
        "--save-timestreams": save_timestreams and "which keeps none",
        "--target-error": target_error is not None and "whose points are run whole",
        "--time-budget": time_budget is not None and "whose points are run whole",
    }
    for option, reason in reasons.items():
        if reason:
            _fail(f"{scene}: {option}: found a sweep, {reason}; a scene without [sweep] is expected")


def _run_sweep(
    sweep: "Sweep", directory: Path, engine: "Engine", resume: bool, figures: bool, force: bool, quiet: bool
) -> None:
    if resume and not quiet:
        report_new_start(directory, "points", "")
    from surveysim.api import run_sweep
    from surveysim.cli.progress import progress_display
    from surveysim.report.terminal.sweep import print_sweep

    work = [point.detector_samples for point in sweep.points]
    with (
        report_resumable_exit(sweep.path, directory),
        progress_display(sweep.name, work, quiet, "points", engine.workers_for(len(work))) as show,
    ):
        progress = stopping(lambda done: show(done, lambda: ""))
        result = run_sweep(sweep, directory, engine, resume, figures, progress, force)
    if not quiet:
        print_sweep(result, directory)


@app.command()
def forecast(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="where results go; of a sweep outputs/<name>_forecast")] = None,
    no_figures: NoFigures = False,
    reference: Reference = None,
    settings: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Say in seconds, without a Monte Carlo, what a scene or every point of its sweep would score."""
    from surveysim.forecasting.forecast import forecast as forecast_scene
    from surveysim.output.directory import claimed, replacing
    from surveysim.output.expected_files import of_forecast
    from surveysim.output.writer import write_forecast
    from surveysim.report.terminal.forecast import print_forecast

    if sweep := _sweep(scene, settings, reference):
        directory = out or default_directory(f"{sweep.name}_forecast", options.settings(settings, reference))
        _forecast_sweep(sweep, directory, not no_figures, force, quiet)
        return
    checked = _ready(scene, settings)
    try:
        found = forecast_scene(checked)
    except ValueError as error:  # of a scene that can't be forecast
        _fail(f"{scene}: {error}")
    if out is not None:
        with claimed(out, of_forecast(checked), force) as place, replacing(place) as new:
            write_forecast(new, found)
    if not quiet:
        print_forecast(checked, found)


def _forecast_sweep(sweep: "Sweep", directory: Path, figures: bool, force: bool, quiet: bool) -> None:
    from surveysim.api import forecast_sweep
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.report.terminal.sweep import print_sweep

    with progress_display(sweep.name, equal_work(len(sweep.points)), quiet, "points") as show:
        result = forecast_sweep(sweep, directory, figures, stopping(lambda done: show(done, lambda: "")), force)
    if not quiet:
        print_sweep(result, directory)


@app.command()
def accuracy(
    scene: Annotated[Path | None, typer.Argument(metavar="[SCENE]", help="a scene file (TOML)")] = None,
    extremes: Annotated[bool, typer.Option("--extremes", help="run the suite of extreme cases instead")] = False,
    out: Annotated[Path | None, typer.Option(help="where results go; outputs/<name>_accuracy by default")] = None,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    reference_error: Annotated[
        float,
        typer.Option(metavar="ERROR", min=1e-4, max=0.99, help="how well the reference should be known, relative"),
    ] = 0.01,
    seeds: Annotated[int, typer.Option(min=1, help="at most so many whole surveys for the reference")] = 8,
    observations: Annotated[int, typer.Option(min=2, help="of each survey that measures another knob")] = 60,
    no_figures: NoFigures = False,
    settings: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Measure what each knob that trades accuracy for time gives and takes, or what comes out of extreme cases."""
    with_engine = options.engine(engine, workers, scheduler)
    if extremes == (scene is not None):
        _fail("accuracy: found both SCENE and --extremes, or none; one of them is expected")
    if extremes:
        if not _run_extremes(out or Path("outputs/extremes"), force, quiet):
            raise typer.Exit(EXIT_FAILED)
        return
    checked = _ready(scene, settings)
    if checked.score is None:
        _fail(f"{scene}: score: missing; accuracy is that of a score")
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.output.directory import claimed, replacing
    from surveysim.output.expected_files import accuracy_settings, of_accuracy
    from surveysim.output.writer import write_accuracy
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
        result = measure_accuracy(scene, given, with_engine, reference_error, seeds, observations, progress)
        with replacing(place) as new:
            write_accuracy(new, result, not no_figures)
    if not quiet:
        print_accuracy(result, directory)


def _run_extremes(directory: Path, force: bool, quiet: bool) -> bool:
    """Run the extreme cases and say what came out; whether all had the outcome that is expected."""
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.output.directory import claimed, replacing
    from surveysim.output.expected_files import EXTREMES
    from surveysim.output.writer import write_extremes
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


@app.command()
def plan(scene: SceneFile, workers: Workers = None, settings: Overrides = None) -> None:
    """Say what would run, what is left out, and what time, memory and disk it would take."""
    from surveysim.reduction.setup import prepare
    from surveysim.report.terminal.plan import print_plan, print_sweep_plan
    from surveysim.runtime.engine import default_workers
    from surveysim.studies.resources import make_plan, make_sweep_plan

    workers = options.engine("processes", workers, None).workers or default_workers()
    if sweep := _sweep(scene, settings):
        print_sweep_plan(sweep, make_sweep_plan(sweep, workers, process_time()), workers)
        return
    checked = _ready(scene, settings)
    print_plan(checked, make_plan(prepare(checked), workers, process_time()), workers)


@app.command()
def paper(
    table: Annotated[list[int] | None, typer.Option(help="number of a table; may be given again")] = None,
    figure: Annotated[list[int] | None, typer.Option(help="number of a figure; may be given again")] = None,
    everything: Annotated[bool, typer.Option("--all", help="all tables and figures there are")] = False,
    out: Annotated[Path | None, typer.Option(help="where they go; outputs/paper by default")] = None,
    scenarios: Annotated[Path, typer.Option(help="folder of the scenes")] = Path("scenarios"),
    observations: Annotated[int | None, typer.Option(help="at most so many a scene, for a quick look")] = None,
    workers: Workers = None,
    engine: Kind = "processes",
    scheduler: Scheduler = None,
    settings: Overrides = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Make the paper's tables and figures from simulated observations, beside the paper's values."""
    from surveysim.cli.progress import equal_work, progress_display
    from surveysim.paper.reproduce import FIGURES, TABLES, reproduce, wanted
    from surveysim.runtime.engine import EngineError

    with_engine = options.engine(engine, workers, scheduler)
    tables = options.numbers("--table", table, TABLES, everything)
    figures = options.numbers("--figure", figure, FIGURES, everything)
    if not tables and not figures:
        _fail("nothing asked for: --table, --figure or --all is expected")
    if observations is not None and observations < 1:
        _fail(f"--observations: found {observations}; 1 or more is expected")
    given = options.settings(settings)
    asked = wanted(tables, figures, scenarios, observations, given)
    own = {} if observations is None else {"paper.observations": observations}
    directory = out or default_directory("paper", given | own)
    done = count(1)
    try:
        work = equal_work(asked.observations)
        with progress_display("paper", work, quiet, workers=with_engine.workers_for(len(work))) as show:
            progress = stopping(lambda: show(next(done), lambda: ""))
            written, failed = reproduce(asked, directory, with_engine, progress, force)
    except EngineError as error:
        complain(str(error))
        raise typer.Exit(EXIT_FAILED) from None
    except (ValueError, ArithmeticError) as error:
        if isinstance(error, SceneError):
            raise
        complain(" ".join(str(error).split()))
        raise typer.Exit(EXIT_FAILED) from None
    if not quiet:
        from surveysim.report.terminal.paper import print_paper

        print_paper(written)
    for line in failed:
        complain(line)
    if failed:
        raise typer.Exit(EXIT_FAILED)


@app.command()
def report(
    directory: Annotated[Path, typer.Argument(metavar="DIR", help="what run, accuracy or paper left there")],
    force: Force = False,
) -> None:
    """Write report.html anew, one page of all that lies in an output directory."""
    from surveysim.output.directory import renewed
    from surveysim.report.html.page import REPORT, NoResultsError, write_report

    try:
        with renewed(directory, REPORT, force):
            say(write_report(directory))
    except NoResultsError as error:
        _fail(str(error))


@app.command()
def check(scene: SceneFile, settings: Overrides = None) -> None:
    """Check a scene: errors only, each with file, key, what was found and what is allowed."""
    if sweep := _sweep(scene, settings):
        say(f"{scene}: {sweep.name!r} is a sweep of {len(sweep.points)} points that can be run")
        return
    checked = _ready(scene, settings)
    say(f"{scene}: {checked.name!r} is a scene that can be run")


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="name of the new scene")],
    like: Annotated[str, typer.Option(help="a scene to start from: a file, or a name in scenarios/")],
) -> None:
    """Write scenarios/NAME.toml, a copy of another scene to edit."""
    source = Path(like) if like.endswith(".toml") else Path("scenarios") / f"{like}.toml"
    target = Path("scenarios") / f"{name}.toml"
    if not re.fullmatch(NAME, name) or len(name) > MAX_NAME:
        _fail(f"name: found {shown(name)}; letters, digits, '_', '.' and '-', none of the last two first, are expected")
    if not source.is_file():
        known = ", ".join(sorted(path.stem for path in Path("scenarios").glob("*.toml"))) or "none here"
        _fail(f"{source}: no such scene; scenes in scenarios/: {known}")
    text, _ = read_scene(source)
    target.parent.mkdir(exist_ok=True)
    try:
        with open(target, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        _fail(f"{target}: exists; another name is expected")
    say(f"{target}: a copy of {source}; edit it, then: surveysim check {target}")
    if "[sweep" in text:
        say("it sweeps keys of its own; give [sweep] yours, or delete it")
    if "[score.reference]" in text:
        say("it compares with published numbers; delete [score.reference] and its gains for another survey")
    if "[excess]" in text or "\nb2 = " in text:
        say("excess noise and b2 are of its own band and site; delete [excess] and atmosphere.b2 for another")


def _ready(path: Path, settings: list[str] | None) -> Scene:
    """A scene that is checked and prepared; raises SceneError whose lines name the file."""
    from surveysim.reduction.setup import prepare

    scene = load_scene(path, options.settings(settings))
    try:
        prepare(scene)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    return scene


def _sweep(path: Path, settings: list[str] | None, reference: str | None = None) -> "Sweep | None":
    """The sweep of a scene file that has one, checked and prepared; raises SceneError for a reference without one."""
    from surveysim.studies.sweep.axes import is_sweep, load_sweep

    if is_sweep(path):
        return load_sweep(path, options.settings(settings), options.point(reference))
    if reference is not None:
        _fail(f"{path}: --reference: found a scene without [sweep]; points of a sweep are expected")
    return None


def _fail(message: str) -> NoReturn:
    raise SceneError(message)
