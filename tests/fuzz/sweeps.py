"""Mangled sweeps: the points of one that is accepted hold the values that a simple reading gives."""

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz import scenes
from tests.fuzz.mangle import NUMBERS, ODD, Raw, mangled_bytes, mangled_tokens, pick, toml
from tests.fuzz.outcomes import Outcome, call, check, outcome_of_end
from tests.scenes import SMALL_SCENE

SPEEDS = '"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]\n'
AXES = f'[sweep]\n{SPEEDS}\n[sweep.pixel]\n"map.pixel" = ["20 arcsec", "30 arcsec"]\n'
NAMES = (
    "$x_2$",
    "\\frac{",
    "a\x1b[31mb",
    "",
    "x" * 500,
    "../../up",
    "a/b",
    "ключ",
    "a\u202eb",
    "reference",
    "{0}",
    "%s",
    "<script>",
)
KEYS = (
    "scan.speed",
    "seed",
    "name",
    "sweep.x",
    "observations",
    "map",
    "scan",
    "scan.speed.x",
    "instrument.layout.dead",
    "a" * 300,
    "x\x1by",
    ".",
    "",
    "sky.point_sources",
    "cleaning.algorithm",
    "score.signal_sims.skies",
    "title",
)


def prepare(folder: Path) -> dict[str, Any]:
    """The base that values of keys are made with."""
    return scenes.prepare(folder)


def mangled(base: dict[str, Any], rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A scene with a mangled sweep in the working directory."""
    how = int(rng.integers(5))
    axes = AXES
    if how == 0:
        axes = mangled_bytes(AXES.encode(), rng).decode("utf-8", "replace")
    elif how == 1:
        axes = mangled_tokens(AXES, rng)
    elif how == 2:
        name = pick(rng, NAMES)
        axes = f"[sweep.{toml(name)}]\n{SPEEDS}"
    elif how == 3:
        key = pick(rng, KEYS)
        axes = f"[sweep]\n{toml(key)} = {toml(_axis(base, rng, key))}\n"
    else:
        key = ".".join(pick(rng, base["keys"]))
        axes = f'[sweep]\n"{key}" = {toml(_axis(base, rng, key))}\n{SPEEDS}'
    Path("scene.toml").write_text(SMALL_SCENE + "\n" + axes, encoding="utf-8", errors="surrogatepass")
    return repr(axes), lambda: tried(base["units"], with_plan=rng.random() < 0.2)


def _axis(base: dict[str, Any], rng: np.random.Generator, key: str) -> Any:
    """Values of an axis: two or three of a key, far too many, or no list at all."""
    path = tuple(key.split("."))
    how = int(rng.integers(8))
    if how == 0:
        return pick(rng, ODD)
    if how == 1:
        return [Raw(pick(rng, NUMBERS)) for _ in range(3)]
    if how == 2:
        return list(range(int(10 ** rng.uniform(1, 4))))
    old = pick(rng, base["bases"]).content
    for name in path:
        old = old.get(name) if isinstance(old, dict) else None
    return [scenes.value(rng, path, old, base["units"]) for _ in range(2)]


def tried(units: dict[tuple[str, ...], str], with_plan: bool) -> Outcome:
    """Check the sweep; where it is accepted, compare its points with the file, and plan it."""
    if refused := outcome_of_end(call("check", "scene.toml")):
        return refused
    from surveysim.scene.kinds import is_sweep
    from surveysim.scene.scene import load_scene
    from surveysim.studies.sweep.axes import load_sweep

    content = tomllib.loads(Path("scene.toml").read_text())
    if not is_sweep("scene.toml"):
        load_scene("scene.toml")
        return Outcome("right")
    sweep = load_sweep("scene.toml")
    for point in sweep.points:
        found = point.scene.model_dump(mode="json", by_alias=True)
        for key, text in point.settings.items():
            where, path = found, tuple(key.split("."))
            for name in path:
                where = where[name]
            check(
                scenes.means(text, where, units.get(path)),
                f"point {point.number}: {key} = {text!r} was read as {where!r}",
            )
    axes = {name: axis for name, axis in content["sweep"].items() if isinstance(axis, dict | list)}
    steps = [len(next(iter(axis.values()))) if isinstance(axis, dict) else len(axis) for axis in axes.values()]
    check(len(sweep.points) == int(np.prod(steps)), f"{len(sweep.points)} points of axes of {steps}")
    if with_plan and (refused := outcome_of_end(call("plan", "scene.toml", "--workers", "1"))):
        return Outcome("silent" if refused.kind == "refused" else refused.kind, f"plan: {refused.text}")
    return Outcome("right")
