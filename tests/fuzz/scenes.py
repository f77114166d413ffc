"""Mangled scene files: what `check` accepts has the meaning that a simple reading gives it, and can be run."""

import json
import math
import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.mangle import NUMBERS, ODD, ODD_QUANTITIES, Raw, mangled_bytes, mangled_tokens, pick, scene_text
from tests.fuzz.outcomes import Outcome, call, check, outcome_of_end
from tests.fuzz.units import Unreadable, quantities, quantity
from tests.scenes import SCHEDULE, SMALL_SCENE, with_scan, without_sections

POSITIONS = """\
# %ECSV 1.0
# ---
# datatype:
# - {name: x, unit: arcmin, datatype: float64}
# - {name: y, unit: arcmin, datatype: float64}
# schema: astropy-2.0
x y
0.0 0.0
1.0 0.0
0.0 1.0
-1.0 0.0
0.0 -1.0
"""
RUN_SAMPLES, RUN_PIXELS = 2e5, 3e5  # a run of more is left out: it would be slow, not wrong
SITE = """\
[atmosphere]
site = "mauna_kea"
spectral_index = "11/3"
illuminated_aperture = "8 m"
"""
DAISY = """\
pattern = "daisy"
radius = "6 arcmin"
radial_period = "10 s"
duration = "30 s"
chunk = "7.5 s"
dither = "2 arcmin"
sample_rate = "10 Hz"

[scan.lissajous]
amplitude_x = "1 arcmin"
amplitude_y = "1 arcmin"
period_x = "31 s"
period_y = "43 s"
"""
MOUNT = """
[telescope]
max_azimuth_velocity = "3 deg / s"
max_elevation_acceleration = "1 deg / s2"
"""
LOAD = """\
[photon]
coherence = "field"

[photon.load]
optics = "20 K"
"""


@dataclass(frozen=True)
class Base:
    """A scene that works: its text, its content, and what the program makes of it, by the names of the file."""

    text: str
    content: dict[str, Any]
    made: dict[str, Any]


def texts() -> list[str]:
    """Scenes that have every section between them."""
    bare = without_sections(SMALL_SCENE, "photon", "atmosphere", "fixed_pointing", "excess")
    site = bare.replace(
        "[instrument.layout]", "bandwidth = 0.15\nefficiency = 0.3\npolarizations = 1\n\n[instrument.layout]"
    )
    table = (
        SMALL_SCENE.split("[instrument.layout]")[0]
        + 'positions = "camera.ecsv"\n\n[scan]'
        + SMALL_SCENE.split("[scan]")[1]
    )
    return [
        SMALL_SCENE,
        SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", "").replace(
            '"average"', '["average", "pca"]\nsigma_cut = 3\ncompare = ["planar", "none"]'
        ),
        site + SCHEDULE + SITE + LOAD,
        table.replace("mask_separation_f_lambda = 1.3\n", ""),
        with_scan(SMALL_SCENE, DAISY) + MOUNT,
    ]


def schema_keys() -> list[tuple[str, ...]]:
    """Every key that a scene may have, in the file's names."""
    from surveysim.scene.scene import Scene

    def walk(model: Any, path: tuple[str, ...]) -> Iterator[tuple[str, ...]]:
        for name, field in model.model_fields.items():
            below = [
                a for a in (field.annotation, *getattr(field.annotation, "__args__", ())) if hasattr(a, "model_fields")
            ]
            yield (*path, field.alias or name)
            for item in below if len(path) < 3 else ():
                yield from walk(item, (*path, field.alias or name))

    return list(dict.fromkeys(path for path in walk(Scene, ()) if path[0] != "assumed"))


def key_units() -> dict[tuple[str, ...], str]:
    """Units of the keys that are quantities."""
    from surveysim.scene.scene import Scene

    schema = Scene.model_json_schema(by_alias=True)

    def parts(item: dict) -> Iterator[dict]:
        for part in (item, *item.get("anyOf", ()), *item.get("oneOf", ())):
            yield schema["$defs"][part["$ref"].rsplit("/", 1)[1]] if "$ref" in part else part

    def walk(item: dict, path: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], str]]:
        for name, below in item.get("properties", {}).items():
            for part in parts(below):
                if "unit" in part:
                    yield (*path, name), part["unit"]
                    _ENDS[(*path, name)] = tuple(part[end] for end in ("at_least", "at_most") if end in part)
                of = next(parts(part["items"])) if isinstance(part.get("items"), dict) else part
                yield from walk(of, (*path, name))

    return dict(walk(schema, ()))


def made(path: Path) -> dict[str, Any]:
    """The scene that the program reads, by the names of the file."""
    from surveysim.scene.scene import load_scene

    return json.loads(json.dumps(load_scene(path).model_dump(mode="json", by_alias=True, exclude={"assumed", "band"})))


_ENDS: dict[tuple[str, ...], tuple[str, ...]] = {}  # documented bounds of quantities
_PREPARED: dict[str, Any] = {}  # for the kinds that share it


def prepare(folder: Path) -> dict[str, Any]:
    """Write and check the scenes that are mangled, and run one."""
    if not _PREPARED:
        _PREPARED.update(_prepared(folder))
    return _PREPARED


def _prepared(folder: Path) -> dict[str, Any]:
    from surveysim.reduction.setup import prepare as prepared
    from surveysim.scene.scene import load_scene

    bases = []
    for number, text in enumerate(texts()):
        path = folder / f"scene{number}" / "scene.toml"
        path.parent.mkdir()
        (path.parent / "camera.ecsv").write_text(POSITIONS)
        path.write_text(text)
        prepared(load_scene(path))
        bases.append(Base(text, tomllib.loads(text), made(path)))
    warm(folder)
    return {"run": folder / "out", "bases": bases, "keys": schema_keys(), "units": key_units()}


def warm(folder: Path) -> None:
    """Load what a run loads, so that no input pays for it."""
    from surveysim import run
    from surveysim.runtime.engine import SERIAL
    from surveysim.scene.scene import load_scene

    run(load_scene(folder / "scene0" / "scene.toml"), folder / "out", engine=SERIAL, figures=False)


def mangled(base: dict[str, Any], rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled scene in the working directory."""
    of = pick(rng, base["bases"])
    how = int(rng.integers(10))
    if how < 1:
        raw = mangled_bytes(of.text.encode(), rng)
    elif how < 4:
        raw = mangled_tokens(of.text, rng).encode("utf-8", "surrogatepass")
    else:
        raw = _with_values(of.content, base, rng).encode("utf-8", "surrogatepass")
    Path("scene.toml").write_bytes(raw)
    Path("camera.ecsv").write_text(POSITIONS)
    shown = _difference(of.text, raw)
    return shown, lambda: tried(of, base["units"], with_run=rng.random() < 0.5)


def _difference(text: str, raw: bytes) -> str:
    """Lines of the mangled scene that the whole one lacks."""
    there = set(text.split("\n")) | set(scene_text(tomllib.loads(text)).split("\n"))
    new = raw.decode("utf-8", "backslashreplace").split("\n")
    return repr([line[:300] for line in new if line not in there] or f"{len(new)} lines, none new")


def value(rng: np.random.Generator, key: tuple[str, ...], old: Any, units: dict[tuple[str, ...], str]) -> Any:
    """An extreme, wrong or odd value of a key."""
    unit = units.get(key, "")
    how = int(rng.integers(16))
    if how == 0:
        return pick(rng, ODD)
    if how == 1:
        return Raw(pick(rng, NUMBERS))
    if how == 2 or not unit:
        number = float(f"{10 ** rng.uniform(-30, 30):.3g}") if rng.random() < 0.5 else int(10 ** rng.uniform(0, 12))
        number = -number if rng.random() < 0.2 else number
        return f"{number:g} {unit}" if unit else [number] * int(rng.integers(1, 4)) if isinstance(old, list) else number
    if how == 3:
        return f"{pick(rng, NUMBERS)} {unit}"
    if how == 4:
        return mangled_tokens(old, rng, 1) if isinstance(old, str) else old
    if how == 5:
        return f"{rng.uniform(0, 100):.3g} {pick(rng, sorted(set(units.values())))}"
    if how == 8 and _ENDS.get(key):  # a documented end of its range, or somewhat within it
        return _scaled(pick(rng, _ENDS[key]), float(f"{10 ** (rng.choice([0, 0, 1, 2]) * rng.uniform(-2, 2)):.3g}"))
    if how > 13 and isinstance(old, str):
        return pick(rng, ODD_QUANTITIES).format(old=old, unit=unit)
    return _scaled(old, float(f"{10 ** rng.normal(0, 6 if how == 7 else 1 if how > 9 else 0.3):.3g}"))


def _scaled(old: Any, factor: float) -> Any:
    """A value with all its numbers times a factor."""
    if isinstance(old, str):
        return re.sub(r"(?<![\w.(/-])\d+\.?\d*", lambda match: f"{float(match[0]) * factor:.6g}", old)
    if isinstance(old, list):
        return [_scaled(item, factor) for item in old]
    if isinstance(old, int) and not isinstance(old, bool):
        return max(round(old * factor), 1)
    return old * factor if isinstance(old, float) else old


def _with_values(content: dict[str, Any], base: dict[str, Any], rng: np.random.Generator) -> str:
    """A scene with one or two keys of the schema, or unknown ones, set to something."""
    content = json.loads(json.dumps(content))
    for _ in range(1 if rng.random() < 0.8 else 2):
        there = [path for path, _ in leaves(content) if all(isinstance(name, str) for name in path)]
        key = pick(rng, there if rng.random() < 0.75 else base["keys"])
        if rng.random() < 0.06:
            key = (*key[:-1], pick(rng, ("unknown", "$x$", "a\x1b[2Jb", "", "k" * 2000, "ключ", "a.b", "\u202eb")))
        if rng.random() < 0.02:
            key = ("n",) * int(10 ** rng.uniform(1, 2.7))
        place: Any = content
        for name in key[:-1]:
            below = place.get(name)
            below = below[0] if isinstance(below, list) and below and isinstance(below[0], dict) else below
            if not isinstance(below, dict):
                below = place[name] = {}
            place = below
        if key[-1] in place and rng.random() < 0.08:
            del place[key[-1]]
        else:
            place[key[-1]] = value(rng, key, place.get(key[-1]), base["units"])
    nested = f"\n[{'.'.join('n' * int(10 ** rng.uniform(2, 4)))}]\n" if rng.random() < 0.01 else ""
    return scene_text(content) + nested


def tried(base: Base, units: dict[tuple[str, ...], str], with_run: bool) -> Outcome:
    """Check the scene in the working directory; where it is accepted, compare its meaning and run it."""
    if refused := outcome_of_end(call("check", "scene.toml")):
        return refused
    content = tomllib.loads(Path("scene.toml").read_bytes().decode("utf-8-sig"))
    if "sweep" not in content:
        compare(base, content, made(Path("scene.toml")), units)
        if with_run and small_enough():
            return run()
    return Outcome("right")


def leaves(item: Any, path: tuple = ()) -> Iterator[tuple[tuple, Any]]:
    """Values of nested tables by their path; lists of tables by number, empty tables as they are."""
    if isinstance(item, dict) and item:
        for key, below in item.items():
            yield from leaves(below, (*path, key))
    elif isinstance(item, list) and item and isinstance(item[0], dict):
        for number, below in enumerate(item):
            yield from leaves(below, (*path, number))
    else:
        yield path, item


def compare(base: Base, content: dict, found: dict, units: dict[tuple[str, ...], str]) -> None:
    """Raise Silent where a key that was not changed has another value, or a changed one not what it says."""
    old, new = dict(leaves(base.content)), dict(leaves(content))
    changed = {path for path in old.keys() | new.keys() if repr(old.get(path)) != repr(new.get(path))}
    tops = {path[:depth] for path in changed for depth in range(1, len(path) + 1)}
    was, now = dict(leaves(base.made)), dict(leaves(found))
    for path in was.keys() | now.keys():
        if repr(was.get(path)) == repr(now.get(path)) or path[-1] == "positions":
            continue
        of_table = any(path[:depth] in changed for depth in range(1, len(path) + 1))
        of_site = path[0] == "atmosphere" and any(key[:1] == ("atmosphere",) for key in changed)
        check(
            path in tops or of_table or of_site or path[0] == "name",
            f"{_dotted(path)}: changed to {now.get(path)!r} in silence",
        )
    for path, number in now.items():
        flat = number if isinstance(number, list) else [number]
        check(all(math.isfinite(n) for n in flat if isinstance(n, float)), f"{_dotted(path)}: {number!r} accepted")
    for path in changed & new.keys():
        if path[-1] != "positions" and path in now:
            unit = units.get(tuple(key for key in path if isinstance(key, str)))
            check(
                means(new[path], now[path], unit),
                f"{_dotted(path)}: {new[path]!r} was read as {now[path]!r} {unit or ''}",
            )


def _dotted(path: tuple) -> str:
    return ".".join(map(str, path))


def means(text: Any, found: Any, unit: str | None) -> bool:
    """Whether a value of the file, read simply, is what was found."""
    if unit is not None and not isinstance(text, dict):
        if "index" in unit:  # whose power the scene's index sets: numbers alone
            unit = unit.split("rad(2")[0].strip() or ""
            return isinstance(text, str | list)
        try:
            wanted = quantities(text, unit) if isinstance(found, list) else [quantity(text, unit)]
        except Unreadable:
            return False
        return np.allclose(wanted, found, rtol=1e-9, atol=0)
    if isinstance(text, bool):
        return False
    if isinstance(text, str) and isinstance(found, float):
        numerator, _, denominator = text.partition("/")
        try:
            return math.isclose(float(numerator) / float(denominator or 1), found)
        except (ValueError, ZeroDivisionError):
            return False
    if isinstance(found, list) and found and isinstance(found[0], list):
        return True  # pairs of a table, or steps of cleaning
    if isinstance(found, list) and not isinstance(text, list):
        return found == [text]
    return found == text


def small_enough() -> bool:
    """Whether one observation of the scene is a matter of a second."""
    from surveysim.reduction.setup import prepare as prepared
    from surveysim.scene.scene import load_scene
    from surveysim.telescope.scans import samples_per_scan

    setup = prepared(load_scene("scene.toml"))
    samples = setup.camera.n_det * setup.observing.scans.n_scans * samples_per_scan(setup.observing.scans)
    skies = setup.scene.score.signal_sims.skies * setup.scene.score.jackknives if setup.scene.score else 1
    pixels = setup.analysis.geometry.n_x * setup.analysis.geometry.n_y * max(1, skies / 8)
    return (
        samples < RUN_SAMPLES and pixels < RUN_PIXELS and (setup.scene.sky is None or not setup.scene.sky.curved_lmax)
    )


def run() -> Outcome:
    """Run few observations of a scene that was accepted: it ends well, or the same overrides are refused."""
    few = ("--set", "observations=2")
    ended = call("run", "scene.toml", "--engine", "serial", "--no-figures", "-q", "--out", "out", *few)
    refused = outcome_of_end(ended)
    if refused is None:
        return whole_summary()
    if refused.kind == "refused" and outcome_of_end(call("check", "scene.toml", *few)):
        return Outcome("right", "with fewer observations refused by both")
    kind = "silent" if refused.kind in ("refused", "message") else refused.kind
    return Outcome(kind, f"check accepts what run refuses with {ended.code}: {refused.text}")


def whole_summary() -> Outcome:
    """The summary is strict JSON, and its scores are finite or missing with a reason."""
    try:
        summary = json.loads(Path("out/summary.json").read_text(), parse_constant=_no_constant)
    except ValueError as error:
        return Outcome("silent", f"summary.json: {error}")
    for name, item in summary["scores"].items():
        check(math.isfinite(item["sigma_ukcmb2"]) and item["sigma_ukcmb2"] > 0, f"sigma(A) of {name}: {item}")
    return Outcome("right")


def _no_constant(name: str) -> None:
    raise ValueError(f"found {name}, which is no JSON")
