"""Options of the command line, from texts to values; SceneError with one line for what can't be understood."""

import tomllib
from typing import TYPE_CHECKING, Any

from surveysim.scene import SceneError

if TYPE_CHECKING:
    from surveysim.stopping import Limits


def settings(given: list[str] | None) -> dict[str, Any]:
    """Values by key of all that --set was given."""
    return dict(setting(item) for item in given or ())


def setting(text: str) -> tuple[str, Any]:
    """Key and value of ``KEY=VALUE``: TOML, or else text without quotes."""
    key, separator, value = text.partition("=")
    if not separator or not all(part.strip() for part in key.split(".")):
        raise SceneError(f"--set: found {text!r}; KEY=VALUE is expected")
    key, value = key.strip(), value.strip()
    try:
        parsed = tomllib.loads(f"value = {value}")
    except ValueError:
        return key, value  # text needs no quotes here
    return key, parsed["value"] if len(parsed) == 1 else value


def numbers(option: str, given: list[int] | None, there: tuple[int, ...], everything: bool) -> list[int]:
    """Numbers of tables or figures, in order; fails for one that can't be made."""
    wrong = [number for number in given or () if number not in there]
    if wrong:
        raise SceneError(f"{option}: found {wrong[0]}; {', '.join(map(str, there))} can be made")
    return [number for number in there if everything or number in (given or ())]


def worker_count(workers: int | None) -> int:
    """How many worker processes: one a core by default."""
    from surveysim.api import default_workers

    if workers is not None and workers < 1:
        raise SceneError(f"--workers: found {workers}; 1 or more is expected")
    return workers or default_workers()


def run_limits(target_error: str | None, time_budget: str | None) -> "Limits":
    """What ends a run early."""
    from surveysim.stopping import parsed_limits

    try:
        return parsed_limits(target_error, time_budget)
    except ValueError as error:
        raise SceneError(str(error)) from None
