"""Runs that left files to go on from, for kinds that mangle these files."""

import contextlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.outcomes import Outcome, call, outcome_of_end

NUMBERS = ("scores", "gains", "scans_discarded", "points", "observations")
Base = tuple[Path, dict[str, Any]]
QUIET = ("--engine", "serial", "--no-figures", "-q", "--out", "out")


def numbers(directory: Path) -> dict[str, Any]:
    """Results in a summary, without times, versions and dates."""
    summary = json.loads((directory / "summary.json").read_text())
    return {key: _untimed(summary[key]) for key in NUMBERS if key in summary}


def _untimed(item: Any) -> Any:
    if isinstance(item, dict):
        return {key: _untimed(below) for key, below in item.items() if not key.endswith("_s")}
    return [_untimed(below) for below in item] if isinstance(item, list) else item


def resumed(whole: dict[str, Any], good: bool | None, refusals: tuple[int, ...] = (2,)) -> Outcome:
    """Go on in `out`: what is mangled is refused, or changes nothing that it should not.

    `good` says that the file has to be accepted with the same results (True), or refused (False); None: a number that
    nobody can know to be wrong was changed, or the same numbers are stored as this program does not store them.
    """
    ended = call("run", "scene.toml", "--resume", *QUIET)
    if refused := outcome_of_end(ended, refusals):
        if good and refused.kind == "refused":
            return Outcome("silent", f"good, but refused: {refused.text}")
        return refused
    try:
        found = numbers(Path("out"))
    except ValueError as error:
        return Outcome("silent", f"summary.json: {error}")
    if good is None or found == whole:
        return Outcome("right")
    return Outcome("silent", "accepted, with other results than a whole run")


def stopped_and_whole(folder: Path, text: str, go: Callable[..., Any], stop: Callable[[Any], None], left: str) -> Base:
    """A folder with a scene and the output of a command that was stopped, and the results of a whole one.

    `go` runs a scene's file; `stop` raises KeyboardInterrupt where its progress is such; `left` has to be there then.
    """
    from surveysim.runtime.engine import SERIAL

    scene, stopped, whole = folder / "stopped" / "scene.toml", folder / "stopped" / "out", folder / "whole"
    scene.parent.mkdir()
    scene.write_text(text)
    with contextlib.suppress(KeyboardInterrupt):
        go(scene, stopped, engine=SERIAL, figures=False, progress=stop)
    go(scene, whole, engine=SERIAL, figures=False)
    if not (stopped / left).exists():
        raise AssertionError(f"the command that was stopped left no {left}")
    return scene.parent, numbers(whole)


def copied(base: Path, name: str) -> tuple[Path, bytes]:
    """Scene and output of a command, in the working directory; returns path and content of a file in the output."""
    shutil.copytree(base, ".", dirs_exist_ok=True)
    path = Path("out") / name
    return path, path.read_bytes()


def odd_array(array: np.ndarray, rng: np.random.Generator) -> tuple[str, np.ndarray, bool | None]:
    """An array with another shape, type or content; whether it can be good."""
    if not array.size:
        return "empty as it was", array, True
    how = int(rng.integers(12))
    flat = array.astype(float)
    if how == 0:
        return "shorter", array[:-1], False
    if how == 1:
        return "longer", np.concatenate([array, array[:1]]) if array.ndim else np.array([array] * 2), False
    if how == 2:
        return "an axis more", array[None], False
    if how == 3:
        return "flat", array.ravel(), array.ndim < 2
    if how == 4:
        return "empty", array[:0] if array.ndim else np.zeros(0), False
    if how == 5:
        return "text", np.full(array.shape, b"x"), False
    if how == 6:
        return "complex", array.astype(complex), False
    if how == 7:
        return "big-endian", array.astype(array.dtype.newbyteorder(">")), None
    if how == 8 and array.ndim > 1:
        return "turned", np.moveaxis(array, 0, -1), array.shape == np.moveaxis(array, 0, -1).shape
    if how == 9:
        return "a scalar", np.array(1.0), False
    flat.flat[int(rng.integers(flat.size))] = value = (np.nan, np.inf, -1e300)[int(rng.integers(3))]
    return f"a value of {value}", flat, None if value == -1e300 else False
