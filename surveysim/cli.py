"""The command line: run, plan, check, new."""

import json
import re
import signal
import sys
import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from surveysim.scene import Scene, SceneError, load_scene

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Monte Carlo surveys of millimetre-wave cameras through a turbulent atmosphere.",
)
SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="a scene file (TOML)")]
Overrides = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override one key")]
Workers = Annotated[int | None, typer.Option(min=1, help="worker processes; one a core by default")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print errors only")]

EXIT_WRONG_SCENE = 2
EXIT_INTERRUPTED = 130


@app.command()
def run(
    scene: SceneFile,
    out: Annotated[Path | None, typer.Option(help="where results go; outputs/<name> by default")] = None,
    workers: Workers = None,
    resume: Annotated[bool, typer.Option("--resume", help="go on from the checkpoint in the output")] = False,
    save_timestreams: Annotated[
        bool, typer.Option("--save-timestreams", help="write every observation to HDF5")
    ] = False,
    no_figures: Annotated[bool, typer.Option("--no-figures", help="leave the figures out")] = False,
    settings: Overrides = None,
    quiet: Quiet = False,
) -> None:
    """Simulate, clean, map and score a scene."""
    checked = _ready(scene, settings)
    directory = out or Path("outputs") / checked.name
    _check_writable(directory)
    from surveysim.api import default_workers
    from surveysim.api import run as run_scene
    from surveysim.progress import progress_display
    from surveysim.report.text import print_result

    workers = workers or default_workers()
    # A batch system's request to stop is treated like Ctrl-C: the checkpoint is kept.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with progress_display(checked, quiet) as progress:
            result = run_scene(
                checked, directory, workers, resume, save_timestreams, not no_figures, progress
            )
    except KeyboardInterrupt:
        kept = (directory / "checkpoint.npz").exists()
        hint = f"; go on with --resume --out {directory}" if kept else ""
        typer.echo(f"interrupted{hint}", err=True)
        raise typer.Exit(EXIT_INTERRUPTED) from None
    if not quiet:
        print_result(result, directory)


@app.command()
def plan(scene: SceneFile, workers: Workers = None, settings: Overrides = None) -> None:
    """Say what would run, what is left out, and what time, memory and disk it would take."""
    checked = _ready(scene, settings)
    from surveysim.api import default_workers
    from surveysim.plan import make_plan
    from surveysim.report.text import print_plan
    from surveysim.setup import prepare

    workers = workers or default_workers()
    print_plan(checked, make_plan(prepare(checked), workers), workers)


@app.command()
def check(scene: SceneFile, settings: Overrides = None) -> None:
    """Check a scene: errors only, each with file, key, what was found and what is allowed."""
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


def main() -> None:
    """Entry point: errors of the user become one line each and exit code 2, never a traceback."""
    from surveysim.checkpoint import CheckpointError

    try:
        app()
    except (SceneError, CheckpointError) as error:
        typer.echo(str(error), err=True)
        sys.exit(EXIT_WRONG_SCENE)
    except OSError as error:
        typer.echo(f"{error.filename or 'output'}: {error.strerror or error}", err=True)
        sys.exit(1)
    except KeyboardInterrupt:
        sys.exit(EXIT_INTERRUPTED)


def _ready(path: Path, settings: list[str] | None) -> Scene:
    """A scene that is checked and prepared; raises SceneError whose lines name the file."""
    from surveysim.setup import prepare

    scene = load_scene(path, dict(_setting(item) for item in settings or ()))
    try:
        prepare(scene)
    except SceneError as error:
        raise SceneError(f"{path}: {error}") from None
    return scene


def _setting(text: str) -> tuple[str, Any]:
    key, separator, value = text.partition("=")
    if not separator:
        raise SceneError(f"--set: found {text!r}; KEY=VALUE is expected")
    try:
        return key.strip(), tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return key.strip(), tomllib.loads(f"value = {json.dumps(value.strip())}")["value"]


def _check_writable(directory: Path) -> None:
    """Fail before an hour of work, not after it, when the output can't be written."""
    directory.mkdir(parents=True, exist_ok=True)
    probe = directory / ".writable"
    probe.touch()
    probe.unlink()


def _fail(message: str) -> None:
    raise SceneError(message)
