"""Copy of the scene file in an output directory: the scene as it was run, with its tables of positions."""

import tomllib
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Origin, Scene, scene_hash, scene_of

if TYPE_CHECKING:
    from surveysim.studies.sweep.axes import Sweep

SCENE_FILE = "scene.toml"
POSITIONS = ("instrument", "positions")
COMMENT = "set for this run"


def scene_files(scene: Scene) -> dict[str, bytes]:
    """Return files by name that reproduce the scene: `scene.toml`, and its table of positions.

    None for a scene that was not read from a file, or was changed since; `scene.json` has all of it.
    """
    if scene.origin is None:
        return {}
    text, files = _self_contained(scene.origin, scene.name)
    content = tomllib.loads(text)
    try:
        again = scene_of(scene.origin.path, text, _with_positions(content, scene), {})
    except SceneError:
        return {}
    return {SCENE_FILE: text.encode()} | files if scene_hash(again) == scene_hash(scene) else {}


def sweep_files(sweep: "Sweep") -> dict[str, bytes]:
    """As `scene_files`, with the table [sweep]."""
    text, files = _self_contained(sweep.origin, sweep.name)
    return {SCENE_FILE: text.encode()} | files


def _with_positions(content: dict[str, Any], scene: Scene) -> dict[str, Any]:
    """Replace the table's name by its present path, before it is copied."""
    if scene.instrument.positions is not None:
        content["instrument"]["positions"] = str(scene.instrument.positions)
    return content


def _self_contained(origin: Origin, name: str) -> tuple[str, dict[str, bytes]]:
    """Make the text of a scene file self-contained, with overrides, name and table names; return it with the tables by
    name.
    """
    content = tomllib.loads(origin.text)
    changes: dict[tuple[str, ...], Any] = {tuple(key.split(".")): value for key, value in origin.overrides.items()}
    if content.get("name") != name:
        changes[("name",)] = name
    tables: dict[str, bytes] = {}
    for keys in (POSITIONS, *_axes_of_positions(content)):
        value = changes.get(keys, _at(content, keys))
        if value is not None:
            changes[keys] = _relocated(value, origin.path.parent, tables)
    if not changes:
        return origin.text, tables
    if changes.keys() == {("name",)} and "name" not in content:
        return f'name = "{name}"\n{origin.text}', tables
    return _changed(origin.text, content, changes), tables


def _axes_of_positions(content: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Keys of the sweep axes with values that are tables of positions."""
    dotted, sweep = ".".join(POSITIONS), content.get("sweep", {})
    found = [("sweep", dotted)] if isinstance(sweep.get(dotted), list) else []
    return found + [
        ("sweep", name, dotted) for name, axis in sweep.items() if isinstance(axis, dict) and dotted in axis
    ]


def _at(content: Any, keys: tuple[str, ...]) -> Any:
    for key in keys:
        content = content.get(key) if isinstance(content, dict) else None
    return content


def _relocated(value: Any, folder: Path, tables: dict[str, bytes]) -> Any:
    """Add tables to the `tables` to write, and return their new name, or a list of names."""
    if isinstance(value, list):
        return [_relocated(item, folder, tables) for item in value]
    content = (folder / value).read_bytes()
    same = [name for name, other in tables.items() if other == content]
    name = same[0] if same else f"positions{f'_{len(tables)}' if tables else ''}.ecsv"
    tables[name] = content
    return name


def _changed(text: str, content: Mapping[str, Any], changes: Mapping[tuple[str, ...], Any]) -> str:
    """Replace some values in the text and keep its comments; without comments if that is not possible."""
    import tomlkit

    expected = deepcopy(dict(content))
    document = tomlkit.parse(text)
    for keys, value in changes.items():
        *sections, last = keys
        plain, written = expected, document
        for section in sections:
            plain, written = plain.setdefault(section, {}), written.setdefault(section, {})
        if value is None:  # left out, which only Python can ask for
            plain.pop(last, None)
            written.pop(last, None)
            continue
        plain[last] = value
        written[last] = _item(value)
    found = tomlkit.dumps(document)
    return found if tomllib.loads(found) == expected else tomlkit.dumps(expected)


def _item(value: Any) -> Any:
    import tomlkit

    item = tomlkit.item(value)
    if not isinstance(value, dict):
        item.comment(COMMENT)
    return item
