"""Options of the command line, from texts to values; SceneError with one line for what can't be understood."""

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from surveysim.runtime.errors import InputError, SceneError

if TYPE_CHECKING:
    from surveysim.results.stopping import StoppingCriteria
    from surveysim.runtime.engine import Engine

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="a scene file (TOML)")]
Overrides = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="override one key")]
Workers = Annotated[int | None, typer.Option(help="worker processes on this machine; one a core by default")]
Kind = Annotated[str, typer.Option("--engine", help="what runs observations: serial, processes or dask")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="of a dask cluster: tcp://host:port, or its scheduler's file")
]
Force = Annotated[
    bool, typer.Option("--force", help="replace other results, and files of yours by the same names, in the output")
]
NoFigures = Annotated[bool, typer.Option("--no-figures", help="leave the figures out")]
Reference = Annotated[
    str | None,
    typer.Option(metavar="POINT", help="of a sweep: the point that ratios are to, by its number or as 'KEY = VALUE'"),
]
DEEPEST = 9  # dots in a key
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print errors only")]


def settings(given: list[str] | None, reference: str | None = None) -> dict[str, Any]:
    """Values by key of all that --set was given, and of a sweep's --reference."""
    chosen = {} if reference is None else {"reference": point(reference)}
    return dict(setting(item) for item in given or ()) | chosen


def setting(text: str) -> tuple[str, Any]:
    """Key and value of ``KEY=VALUE``: TOML, or else text without quotes."""
    key, separator, value = text.partition("=")
    if not separator or not all(part.strip() for part in key.split(".")):
        raise SceneError(f"--set: found {text!r}; KEY=VALUE is expected")
    key, value = key.strip(), value.strip()
    if key.count(".") > DEEPEST:
        raise SceneError(f"--set: {key}: found {key.count('.') + 1} names; no key of a scene is that deep")
    try:
        parsed = tomllib.loads(f"value = {value}")
    except RecursionError:
        raise SceneError(f"--set: {key}: found a value that is nested too deeply") from None
    except ValueError:
        return key, value  # text needs no quotes here
    return key, parsed["value"] if len(parsed) == 1 else value


def point(given: str | None) -> int | str | None:
    """A point of a sweep by its number or, as text, by its values."""
    return int(given) if given is not None and given.strip().isdecimal() else given


def numbers(option: str, given: list[int] | None, there: tuple[int, ...], everything: bool) -> list[int]:
    """Numbers of tables or figures, in order; fails for one that can't be made."""
    wrong = [number for number in given or () if number not in there]
    if wrong:
        raise SceneError(f"{option}: found {wrong[0]}; {', '.join(map(str, there))} can be made")
    return [number for number in there if everything or number in (given or ())]


def engine(kind: str, workers: int | None, scheduler: str | None) -> "Engine":
    """What runs observations: by its kind, number of workers and scheduler."""
    from surveysim.runtime.addresses import address_of
    from surveysim.runtime.engine import Engine, EngineError

    try:
        chosen = Engine(kind, workers, scheduler)
        if scheduler is not None:
            address_of(scheduler)
        return chosen
    except (InputError, EngineError) as error:
        raise SceneError(f"--{error}") from None


def run_limits(target_error: str | None, time_budget: str | None) -> "StoppingCriteria":
    """What ends a run early."""
    from surveysim.results.stopping import parsed_limits

    try:
        return parsed_limits(target_error, time_budget)
    except InputError as error:
        raise SceneError(str(error)) from None
