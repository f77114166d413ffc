"""Command-line options, parsed from text; SceneError with one line for invalid text."""

import tomllib
from glob import escape, glob
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.shipped import find_scene, scene_names

if TYPE_CHECKING:
    from surveysim.reduction.setup import Setup
    from surveysim.results.stopping import StoppingCriteria
    from surveysim.runtime.engine import Engine
    from surveysim.scene.bands import MultiBandScene
    from surveysim.studies.sweep.axes import Sweep
    from surveysim.studies.sweep.bands import MultiBandSweep

DEEPEST = 9  # dots in a key
LARGEST_TEXT = 1_000_000  # bytes of a scene that is read in advance
MANY = 64  # observations that worker processes share, unless they have very few samples


def _scene_file(scene: Path | None) -> Path | None:
    return scene and find_scene(scene)


def scene_completions(incomplete: str) -> list[str]:
    """Names of scenes, TOML files and folders that begin as the user has typed."""
    names = [name for name in scene_names() if name.startswith(incomplete)]
    paths = [*glob(f"{escape(incomplete)}*.toml"), *glob(f"{escape(incomplete)}*/")]
    return names + sorted(paths)


SCENE = typer.Argument(
    metavar="SCENE",
    callback=_scene_file,
    autocompletion=scene_completions,
    help="A scene file (TOML), or a name such as lynx or first_light.",
)
SceneFile = Annotated[Path, SCENE]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Replace the value of a key, or remove it: KEY=. May be repeated."),
]
Workers = Annotated[
    int | None, typer.Option(metavar="N", help="Worker processes on this machine; by default one per core.")
]
Kind = Annotated[
    str, typer.Option("--engine", metavar="KIND", help="Where observations run: serial, processes or dask.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Dask scheduler: tcp://host:port, or the path of its scheduler file."),
]
Force = Annotated[
    bool, typer.Option("--force", help="Overwrite the output directory, even other results and files of your own.")
]
NoFigures = Annotated[bool, typer.Option("--no-figures", help="Draw no figures.")]
Reference = Annotated[
    str | None,
    typer.Option(metavar="POINT", help="Sweep point that ratios refer to: its number, or 'KEY = VALUE'."),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print all tables of the report.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")]


def settings(given: list[str] | None, reference: str | None = None) -> dict[str, Any]:
    """Parse all --set options to values by key, and the --reference of a sweep."""
    chosen = {} if reference is None else {"reference": point(reference)}
    return dict(setting(item) for item in given or ()) | chosen


def setting(text: str) -> tuple[str, Any]:
    """Parse ``KEY=VALUE``, with a TOML value or text without quotes; ``KEY=`` gives None, which removes the key."""
    key, separator, value = text.partition("=")
    if not separator or not all(part.strip() for part in key.split(".")):
        raise SceneError(f"--set: found {text!r}; KEY=VALUE is expected")
    key, value = key.strip(), value.strip()
    if key.count(".") > DEEPEST:
        raise SceneError(f"--set: {key}: found {key.count('.') + 1} names; no key of a scene is that deep")
    if not value:
        return key, None
    try:
        parsed = tomllib.loads(f"value = {value}")
    except RecursionError:
        raise SceneError(f"--set: {key}: found a value that is nested too deeply") from None
    except ValueError:
        return key, value  # text needs no quotes here
    return key, parsed["value"] if len(parsed) == 1 else value


def point(given: str | None) -> int | str | None:
    """Parse a point of a sweep: a number, or text with its values."""
    return int(given) if given is not None and given.strip().isdecimal() else given


def numbers(option: str, given: list[int] | None, there: tuple[int, ...], everything: bool) -> list[int]:
    """Sort numbers of tables or figures; raises SceneError for one that does not exist."""
    wrong = [number for number in given or () if number not in there]
    if wrong:
        raise SceneError(f"{option}: found {wrong[0]}; {', '.join(map(str, there))} can be made")
    return [number for number in there if everything or number in (given or ())]


def at_least(option: str, found: int, least: int) -> None:
    """Raise SceneError for a number below the least that an option takes."""
    if found < least:
        raise SceneError(f"{option}: found {found}; {least} or more is expected")


def engine(kind: str, workers: int | None, scheduler: str | None) -> "Engine":
    """Make the engine that runs observations, by its kind, number of workers and scheduler."""
    from surveysim.runtime.addresses import address_of
    from surveysim.runtime.engine import Engine, EngineError

    try:
        chosen = Engine(kind, workers, scheduler)
        if scheduler is not None:
            address_of(scheduler)
        return chosen
    except (InputError, EngineError) as error:
        raise SceneError(f"--{error}") from None


def run_limits(target_error: str | None, time_budget: str | None, metric: str | None) -> "StoppingCriteria":
    """Read the criteria that stop a run early."""
    from surveysim.results.stopping import parsed_limits

    try:
        return parsed_limits(target_error, time_budget, metric)
    except InputError as error:
        raise SceneError(str(error)) from None


def ready_setup(path: Path, given: list[str] | None) -> "Setup":
    """Load, check and prepare a scene; raises SceneError with lines that name the file."""
    from surveysim.reduction.setup import prepare
    from surveysim.scene.scene import load_scene

    scene = load_scene(path, settings(given))
    try:
        return prepare(scene)
    except SceneError as error:
        changed = "".join(f" --set {item}" for item in given or ())
        raise SceneError(f"{path}{' with' if changed else ''}{changed}: {error}") from None


def has_many_observations(path: Path, given: list[str] | None) -> bool:
    """Return whether the text of a scene has many observations; the scene is not checked."""
    try:
        if not path.is_file() or path.stat().st_size > LARGEST_TEXT:  # a pipe can be read once
            return False
        content = tomllib.loads(path.read_text(encoding="utf-8")) | settings(given)
        return bool(content["observations"] >= MANY)
    except Exception:  # which is reported when the scene is read with care
        return False


def sweep_of(path: Path, given: list[str] | None, reference: str | None = None) -> "Sweep | MultiBandSweep | None":
    """Load, check and prepare the sweep of a scene file that has one; raises SceneError for a reference without a
    sweep.
    """
    from surveysim.scene.kinds import has_bands, is_sweep

    if not is_sweep(path):
        if reference is not None:
            fail(f"{path}: --reference: found a scene without [sweep]; points of a sweep are expected")
        return None
    from surveysim.studies.sweep.axes import load_sweep
    from surveysim.studies.sweep.bands import load_band_sweep

    load = load_band_sweep if has_bands(path) else load_sweep
    return load(path, settings(given), point(reference))


def bands_of(path: Path, given: list[str] | None) -> "MultiBandScene | None":
    """Load, check and prepare all bands of a scene file; None without bands, SceneError with lines that name them."""
    from surveysim.scene.kinds import has_bands

    if not has_bands(path):
        return None
    from surveysim.reduction.setup import prepare
    from surveysim.scene.bands import load_bands, of_each_band

    scenes = load_bands(path, settings(given))
    of_each_band(path, scenes.content, lambda name: prepare(scenes.bands[name]))
    return scenes


def fail(message: str) -> NoReturn:
    """Raise SceneError, which ends the command with exit code 2 and this message."""
    raise SceneError(message)
