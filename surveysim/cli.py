"""The command line: run, forecast, plan, paper, check, new."""

import re
import signal
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from itertools import count
from pathlib import Path
from threading import Event
from time import process_time
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from surveysim.scene import Scene, SceneError, load_scene

if TYPE_CHECKING:
    from surveysim.sweep import Sweep

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Monte Carlo surveys of millimetre-wave cameras through a turbulent atmosphere.",
)
SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="a scene file (TOML)")]
Overrides = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override one key")]
Workers = Annotated[int | None, typer.Option(help="worker processes; one a core by default")]
NoFigures = Annotated[bool, typer.Option("--no-figures", help="leave the figures out")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print errors only")]

_asked_to_stop = Event()
EXIT_FAILED = 1
EXIT_WRONG_SCENE = 2
EXIT_INTERRUPTED = 130


def _says_interrupted(command: Callable[..., None]) -> Callable[..., None]:
    """A command that ends with one line and exit code 130 on Ctrl-C."""

    @wraps(command)
    def wrapped(*arguments: Any, **options: Any) -> None:
        try:
            command(*arguments, **options)
        except KeyboardInterrupt:
            typer.echo("interrupted", err=True)
            raise typer.Exit(EXIT_INTERRUPTED) from None

    return wrapped


@app.command()
@_says_interrupted
def run(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="where results go; outputs/<name> by default")] = None,
    workers: Workers = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on from the checkpoint in the output")] = False,
    save_timestreams: Annotated[
        bool, typer.Option("--save-timestreams", help="write every observation to HDF5")
    ] = False,
    no_figures: NoFigures = False,
    settings: Overrides = None,
    quiet: Quiet = False,
) -> None:
    """Simulate, clean, map and score a scene, or every point of its sweep."""
    workers = _workers(workers)
    if sweep := _sweep(scene, settings):
        if save_timestreams:
            _fail(f"{scene}: --save-timestreams: found a sweep, which keeps none; a scene without [sweep] is expected")
        _run_sweep(sweep, out, workers, resume, not no_figures, quiet)
        return
    checked = _ready(scene, settings)
    from surveysim.outputs import check_writable

    directory = out or Path("outputs") / checked.name
    check_writable(directory)
    if resume and not quiet and not (directory / "checkpoint.npz").exists():
        typer.echo(f"no checkpoint in {directory}: starting with the first observation", err=True)
    from surveysim.api import run as run_scene
    from surveysim.progress import progress_display, score_so_far
    from surveysim.report.text import print_result

    with _going_on_later(scene, directory), progress_display(checked.name, checked.observations, quiet) as show:
        progress = _stopping(lambda coadds: show(coadds.done, lambda: score_so_far(checked, coadds)))
        result = run_scene(checked, directory, workers, resume, save_timestreams, not no_figures, progress)
    if not quiet:
        print_result(result, directory)


def _run_sweep(sweep: "Sweep", out: Path | None, workers: int, resume: bool, figures: bool, quiet: bool) -> None:
    from surveysim.outputs import check_writable

    directory = out or Path("outputs") / sweep.name
    check_writable(directory)
    if resume and not quiet and not _kept(directory):
        typer.echo(f"no points in {directory}: starting with the first", err=True)
    from surveysim.api import run_sweep
    from surveysim.progress import progress_display
    from surveysim.report.text import print_sweep

    total = len(sweep.points)
    with _going_on_later(sweep.path, directory), progress_display(sweep.name, total, quiet, "points") as show:
        result = run_sweep(sweep, directory, workers, resume, figures, _stopping(lambda done: show(done, lambda: "")))
    if not quiet:
        print_sweep(result, directory)


@app.command()
@_says_interrupted
def forecast(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="where results go; of a sweep outputs/<name>_forecast")] = None,
    no_figures: NoFigures = False,
    settings: Overrides = None,
    quiet: Quiet = False,
) -> None:
    """Say in seconds, without a Monte Carlo, what a scene or every point of its sweep would score."""
    from surveysim.forecast import forecast as forecast_scene
    from surveysim.outputs import check_writable, write_forecast
    from surveysim.report.text import print_forecast

    if sweep := _sweep(scene, settings):
        _forecast_sweep(sweep, out or Path("outputs") / f"{sweep.name}_forecast", not no_figures, quiet)
        return
    checked = _ready(scene, settings)
    try:
        found = forecast_scene(checked)
    except ValueError as error:  # of a scene that can't be forecast
        _fail(f"{scene}: {error}")
    if out is not None:
        check_writable(out)
        write_forecast(out, found)
    if not quiet:
        print_forecast(checked, found)


def _forecast_sweep(sweep: "Sweep", directory: Path, figures: bool, quiet: bool) -> None:
    from surveysim.api import forecast_sweep
    from surveysim.outputs import check_writable
    from surveysim.progress import progress_display
    from surveysim.report.text import print_sweep

    check_writable(directory)
    with progress_display(sweep.name, len(sweep.points), quiet, "points") as show:
        result = forecast_sweep(sweep, directory, figures, _stopping(lambda done: show(done, lambda: "")))
    if not quiet:
        print_sweep(result, directory)


@app.command()
@_says_interrupted
def plan(scene: SceneFile, workers: Workers = None, settings: Overrides = None) -> None:
    """Say what would run, what is left out, and what time, memory and disk it would take."""
    from surveysim.plan import make_plan, make_sweep_plan
    from surveysim.report.text import print_plan, print_sweep_plan
    from surveysim.setup import prepare

    workers = _workers(workers)
    if sweep := _sweep(scene, settings):
        print_sweep_plan(sweep, make_sweep_plan(sweep, workers, process_time()), workers)
        return
    checked = _ready(scene, settings)
    print_plan(checked, make_plan(prepare(checked), workers, process_time()), workers)


@app.command()
@_says_interrupted
def paper(
    table: Annotated[list[int] | None, typer.Option(help="number of a table; may be given again")] = None,
    figure: Annotated[list[int] | None, typer.Option(help="number of a figure; may be given again")] = None,
    everything: Annotated[bool, typer.Option("--all", help="all tables and figures there are")] = False,
    out: Annotated[Path, typer.Option(help="where they go")] = Path("outputs/paper"),
    scenarios: Annotated[Path, typer.Option(help="folder of the scenes")] = Path("scenarios"),
    observations: Annotated[int | None, typer.Option(help="at most so many a scene, for a quick look")] = None,
    workers: Workers = None,
    settings: Overrides = None,
    quiet: Quiet = False,
) -> None:
    """Make the paper's tables and figures from simulated observations, beside the paper's values."""
    from surveysim.engines import WorkerLostError
    from surveysim.progress import progress_display
    from surveysim.reproduce import FIGURES, TABLES, reproduce, wanted

    workers = _workers(workers)
    tables = _numbers("--table", table, TABLES, everything)
    figures = _numbers("--figure", figure, FIGURES, everything)
    if not tables and not figures:
        _fail("nothing asked for: --table, --figure or --all is expected")
    if observations is not None and observations < 1:
        _fail(f"--observations: found {observations}; 1 or more is expected")
    asked = wanted(tables, figures, scenarios, observations, _settings(settings))
    out.mkdir(parents=True, exist_ok=True)
    done = count(1)
    try:
        with progress_display("paper", asked.observations, quiet) as show:
            written, failed = reproduce(asked, out, workers, _stopping(lambda: show(next(done), lambda: "")))
    except WorkerLostError:
        typer.echo("a worker process is gone, perhaps killed for want of memory", err=True)
        raise typer.Exit(EXIT_FAILED) from None
    except (ValueError, ArithmeticError) as error:
        if isinstance(error, SceneError):
            raise
        typer.echo(" ".join(str(error).split()), err=True)
        raise typer.Exit(EXIT_FAILED) from None
    if not quiet:
        from surveysim.report.text import print_paper

        print_paper(written)
    for line in failed:
        typer.echo(line, err=True)
    if failed:
        raise typer.Exit(EXIT_FAILED)


def _numbers(option: str, given: list[int] | None, there: tuple[int, ...], everything: bool) -> list[int]:
    """Numbers of tables or figures, in order; fails for one that can't be made."""
    wrong = [number for number in given or () if number not in there]
    if wrong:
        _fail(f"{option}: found {wrong[0]}; {', '.join(map(str, there))} can be made")
    return [number for number in there if everything or number in (given or ())]


@app.command()
@_says_interrupted
def check(scene: SceneFile, settings: Overrides = None) -> None:
    """Check a scene: errors only, each with file, key, what was found and what is allowed."""
    if sweep := _sweep(scene, settings):
        typer.echo(f"{scene}: {sweep.name!r} is a sweep of {len(sweep.points)} points that can be run")
        return
    checked = _ready(scene, settings)
    typer.echo(f"{scene}: {checked.name!r} is a scene that can be run")


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="name of the new scene")],
    like: Annotated[str, typer.Option(help="a scene to start from: a file, or a name in scenarios/")],
) -> None:
    """Write scenarios/NAME.toml, a copy of another scene to edit."""
    source = Path(like) if like.endswith(".toml") else Path("scenarios") / f"{like}.toml"
    target = Path("scenarios") / f"{name}.toml"
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        _fail(f"name: found {name!r}; letters, digits, '_', '.' and '-' are expected")
    if target.exists():
        _fail(f"{target}: exists; another name is expected")
    if not source.is_file():
        known = ", ".join(sorted(path.stem for path in Path("scenarios").glob("*.toml"))) or "none here"
        _fail(f"{source}: no such scene; scenes in scenarios/: {known}")
    text = source.read_text(encoding="utf-8")
    target.parent.mkdir(exist_ok=True)
    target.write_text(text, encoding="utf-8")
    typer.echo(f"{target}: a copy of {source}; edit it, then: surveysim check {target}")
    if "[score.reference]" in text:
        typer.echo("it compares with published numbers; delete [score.reference] and its gains for another survey")


def main() -> None:
    """Entry point: errors of the user become one line each and exit code 2, never a traceback."""
    _asked_to_stop.clear()
    # A batch system's request to stop is treated like Ctrl-C: the checkpoint is kept.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop_once)
    try:
        app()
    except SceneError as error:
        typer.echo(str(error), err=True)
        sys.exit(EXIT_WRONG_SCENE)
    except OSError as error:
        typer.echo(_cause(error), err=True)
        sys.exit(EXIT_FAILED)
    except MemoryError:
        typer.echo("not enough memory for this scene; 'surveysim plan' says how much one takes", err=True)
        sys.exit(EXIT_FAILED)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)


def _stop_once(number: int, frame: object) -> None:
    """Interrupt the run; a second Ctrl-C would only cut short the saving of its checkpoint."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    _asked_to_stop.set()
    # Python drops, with a traceback, what is raised inside a finalizer; `_stopping` raises it again.
    sys.unraisablehook = _without_interrupts
    raise KeyboardInterrupt


def _without_interrupts(unraisable: Any) -> None:
    if not issubclass(unraisable.exc_type, KeyboardInterrupt):
        sys.__unraisablehook__(unraisable)


def _stopping(show: Callable[..., None]) -> Callable[..., None]:
    """Progress that ends a run whose interrupt was lost in a finalizer."""

    def progress(*state: Any) -> None:
        if _asked_to_stop.is_set():
            raise KeyboardInterrupt
        show(*state)

    return progress


@contextmanager
def _going_on_later(scene: Path, directory: Path) -> Iterator[None]:
    """End with one line where a run stops: why, and how to go on if anything is kept in `directory`."""
    from surveysim.checkpoint import CheckpointError
    from surveysim.engines import WorkerLostError

    try:
        yield
    except CheckpointError as error:
        _fail(str(error))
    except KeyboardInterrupt:
        _stopped("interrupted", directory, EXIT_INTERRUPTED)
    except WorkerLostError:
        _stopped("a worker process is gone, perhaps killed for want of memory", directory, EXIT_FAILED)
    except OSError as error:
        _stopped(_cause(error), directory, EXIT_FAILED)
    except (ValueError, ArithmeticError) as error:
        _stopped(f"{scene}: an observation failed: {error}", directory, EXIT_FAILED)


def _stopped(reason: str, directory: Path, code: int) -> NoReturn:
    """Say why a run stopped and how to go on; leave no half-written file."""
    for pattern in ("timestreams/*.h5.part", "points/*.npz.part"):  # of workers that were killed
        for partial in directory.glob(pattern):
            partial.unlink(missing_ok=True)
    hint = f"; go on with --resume --out {directory}" if _kept(directory) else ""
    typer.echo(" ".join(reason.split()) + hint, err=True)
    raise typer.Exit(code)


def _kept(directory: Path) -> bool:
    """Whether there is anything that a run could go on from."""
    return (directory / "checkpoint.npz").exists() or any(directory.glob("points/*.npz"))


def _cause(error: OSError) -> str:
    return f"{error.filename or 'output'}: {error.strerror or error}"


def _workers(workers: int | None) -> int:
    from surveysim.api import default_workers

    if workers is not None and workers < 1:
        raise SceneError(f"--workers: found {workers}; 1 or more is expected")
    return workers or default_workers()


def _ready(path: Path, settings: list[str] | None) -> Scene:
    """A scene that is checked and prepared; raises SceneError whose lines name the file."""
    from surveysim.setup import prepare

    scene = load_scene(path, _settings(settings))
    try:
        prepare(scene)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    return scene


def _sweep(path: Path, settings: list[str] | None) -> "Sweep | None":
    """The sweep of a scene file that has one, checked and prepared."""
    from surveysim.sweep import is_sweep, load_sweep

    return load_sweep(path, _settings(settings)) if is_sweep(path) else None


def _settings(given: list[str] | None) -> dict[str, Any]:
    return dict(_setting(item) for item in given or ())


def _setting(text: str) -> tuple[str, Any]:
    key, separator, value = text.partition("=")
    if not separator or not all(part.strip() for part in key.split(".")):
        raise SceneError(f"--set: found {text!r}; KEY=VALUE is expected")
    key, value = key.strip(), value.strip()
    try:
        parsed = tomllib.loads(f"value = {value}")
    except ValueError:
        return key, value  # text needs no quotes here
    return key, parsed["value"] if len(parsed) == 1 else value


def _fail(message: str) -> NoReturn:
    raise SceneError(message)
