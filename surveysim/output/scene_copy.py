"""Copy of the scene file in an output directory: the scene as it was run, with its tables."""

import tomllib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surveysim.runtime.errors import SceneError
from surveysim.scene.bands import TABLE, MultiBandScene
from surveysim.scene.file_keys import file_keys
from surveysim.scene.scene import Origin, Scene, scene_hash, scene_of
from surveysim.telescope.diffraction import with_beam

if TYPE_CHECKING:
    from surveysim.studies.sweep.axes import Sweep
    from surveysim.studies.sweep.bands import MultiBandSweep

SCENE_FILE = "scene.toml"
COMMENT = "set for this run"
Keys = tuple[str | int, ...]  # the way to a value: names of keys, and numbers of tables in a list


def scene_files(scene: Scene) -> dict[str, bytes]:
    """Return files by name that reproduce the scene: `scene.toml`, without a table [sweep], and its tables.

    None for a scene that was not read from a file, or was changed since; `scene.json` has all of it.
    """
    if scene.origin is None:
        return {}
    overrides = {key: value for key, value in scene.origin.overrides.items() if not key.startswith("sweep.")}
    alone = overrides | ({"sweep": None} if "sweep" in tomllib.loads(scene.origin.text) else {})
    text, files = _self_contained(replace(scene.origin, overrides=alone), scene.name)
    try:
        again = scene_of(scene.origin.path, scene.origin.text, tomllib.loads(scene.origin.text), scene.origin.overrides)
    except SceneError:
        return {}
    # A prepared scene has the beam that the file leaves out.
    same = scene_hash(with_beam(again)) == scene_hash(with_beam(scene))
    return {SCENE_FILE: text.encode()} | files if same else {}


def bands_files(scenes: "MultiBandScene | MultiBandSweep") -> dict[str, bytes]:
    """As `scene_files`, of a camera of several bands."""
    text, files = _self_contained(scenes.origin, scenes.name)
    return {SCENE_FILE: text.encode()} | files


def sweep_files(sweep: "Sweep") -> dict[str, bytes]:
    """As `scene_files`, with the table [sweep]; none of one band, whose camera has them."""
    if sweep.points[0].scene.band:
        return {}
    text, files = _self_contained(sweep.origin, sweep.name)
    return {SCENE_FILE: text.encode()} | files


def _self_contained(origin: Origin, name: str) -> tuple[str, dict[str, bytes]]:
    """Make the text of a scene file self-contained, with overrides, name and table names; return it with the tables by
    name.
    """
    content = tomllib.loads(origin.text)
    changes: dict[Keys, Any] = {tuple(key.split(".")): value for key, value in origin.overrides.items()}
    if content.get("name") != name:
        changes[("name",)] = name
    tables: dict[str, bytes] = {}
    for keys, value in file_values(_with(content, changes)):
        changes[keys] = _relocated(value, str(keys[-1]).rpartition(".")[2], origin.path.parent, tables)
    if not changes:
        return origin.text, tables
    if changes.keys() == {("name",)} and "name" not in content:
        return f'name = "{name}"\n{origin.text}', tables
    return _changed(origin.text, content, changes), tables


def file_values(content: Mapping[str, Any]) -> Iterator[tuple[Keys, Any]]:
    """Find the names of files in a scene, and lists of them in its sweep, with their keys."""
    sweep = content.get("sweep", {})
    bands = [f"{TABLE}.{name}." for name in content.get(TABLE, {})]
    for key in (f"{band}{key}" for band in ("", *bands) for key in file_keys()):
        yield from _text_at(content, (), key.split("."))
        for axis, place in ((sweep, ("sweep",)), *((item, ("sweep", name)) for name, item in sweep.items())):
            if isinstance(axis, dict) and isinstance(axis.get(key), list):
                yield (*place, key), axis[key]


def _text_at(content: Any, place: Keys, names: list[str]) -> Iterator[tuple[Keys, str]]:
    """Find the texts at a dotted key, in each table of a list."""
    if isinstance(content, list) and names:
        for number, item in enumerate(content):
            yield from _text_at(item, (*place, number), names)
    elif not names and isinstance(content, str) and Path(content).suffix:  # else the name of something that ships
        yield place, content
    elif names and isinstance(content, dict) and names[0] in content:
        yield from _text_at(content[names[0]], (*place, names[0]), names[1:])


def _relocated(value: Any, key: str, folder: Path, tables: dict[str, bytes]) -> Any:
    """Add tables to the `tables` to write, and return their new name, or a list of names."""
    if isinstance(value, list):
        return [_relocated(item, key, folder, tables) if isinstance(item, str) else item for item in value]
    content, suffix = (folder / value).read_bytes(), Path(value).suffix
    same = [name for name, other in tables.items() if other == content]
    number = sum(name.startswith(key) for name in tables)
    name = same[0] if same else f"{key}{f'_{number}' if number else ''}{suffix}"
    tables[name] = content
    return name


def _changed(text: str, content: Mapping[str, Any], changes: Mapping[Keys, Any]) -> str:
    """Replace some values in the text and keep its comments; without comments if that is not possible."""
    import tomlkit

    expected, document = _with(content, changes), tomlkit.parse(text)
    for keys, value in changes.items():
        _put(document, keys, None if value is None else _item(value))
    found = tomlkit.dumps(document)
    return found if tomllib.loads(found) == expected else tomlkit.dumps(expected)


def _with(content: Mapping[str, Any], changes: Mapping[Keys, Any]) -> dict[str, Any]:
    found = deepcopy(dict(content))
    for keys, value in changes.items():
        _put(found, keys, value)
    return found


def _put(content: Any, keys: Keys, value: Any) -> None:
    """Set one value, or take it out if it is None."""
    *sections, last = keys
    for section in sections:
        content = content.setdefault(section, {}) if isinstance(section, str) else content[section]
    if value is None:
        content.pop(last, None)
    else:
        content[last] = value


def _item(value: Any) -> Any:
    import tomlkit

    item = tomlkit.item(value)
    if not isinstance(value, dict):
        item.comment(COMMENT)
    return item
