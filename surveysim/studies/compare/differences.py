"""Settings that differ between scenes: keys of scene files with the value of each scene."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from surveysim.scene.keys import all_keys, scene_keys
from surveysim.studies.sweep.choices import value_text

_SAME = ("name", "title", "assumed", "band", "other_bands")  # of no influence, or told elsewhere
NONE = "none"
_LONGEST = 60
_ANGLES = {"rad": "", "rad s": " / s"}  # internal unit, and the rest of the shown one


def differences(scenes: Sequence[Mapping[str, Any]], settings: Sequence[Mapping[str, Any]]) -> dict[str, list[str]]:
    """Return the keys whose values differ, with the text of each scene's value.

    Parameters
    ----------
    scenes
        Content of scene.json of each: all values in internal units, with defaults.
    settings
        Content of the scene files, whose values are shown where they are known.
    """
    resolved = [dict(_leaves(scene, "")) for scene in scenes]
    written = [{key: value for key, value in scene_keys(own)} for own in settings]
    names = dict.fromkeys(name for leaves in resolved for name in leaves)
    found: dict[str, list[str]] = {}
    for name in names:
        values = [leaves.get(name) for leaves in resolved]
        if all(value == values[0] for value in values) or name.partition(".")[0] in _SAME:
            continue
        key, unit = _key_of(name)
        of_file = [own.get(key) if "[" not in name else None for own in written]
        found[key] = [_text(value, given, unit) for value, given in zip(values, of_file, strict=True)]
    return found


def _leaves(content: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Yield dotted names of values, with the number of a table in a list in brackets."""
    if isinstance(content, Mapping):
        for key, value in content.items():
            yield from _leaves(value, f"{name}.{key}".lstrip("."))
    elif isinstance(content, list) and content and all(isinstance(item, Mapping) for item in content):
        for number, item in enumerate(content):
            yield from _leaves(item, f"{name}[{number}]")
    elif content is not None and content != []:
        yield name, content


def _key_of(name: str) -> tuple[str, str]:
    """Key of a scene file, and the unit in the name of the resolved value; the name itself for no known key."""
    section, _, field = name.rpartition(".")
    plain = "".join(part.partition("]")[2] if "]" in part else part for part in section.split("["))
    known = {key.rpartition(".")[2] for key in all_keys() if key.rpartition(".")[0] == plain}
    fits = [key for key in known if field == key or field.startswith(f"{key}_")]
    if not fits:
        return name, ""
    key = max(fits, key=len)
    return f"{section}.{key}".lstrip("."), field[len(key) + 1 :].replace("_", " ")


def _number(value: float, unit: str) -> str:
    """Text of a number in internal units; angles are in degrees, or below one degree in arcsec."""
    if unit not in _ANGLES:
        return f"{value:.6g} {unit}".rstrip()
    degrees = math.degrees(value)
    text = f"{degrees:.6g} deg" if abs(degrees) >= 1 else f"{3600 * degrees:.6g} arcsec"
    return text + _ANGLES[unit]


def _text(value: Any, given: Any, unit: str) -> str:
    if given is not None:
        text = value_text(given)
    elif value is None:
        return NONE
    else:
        text = _number(value, unit) if isinstance(value, float) else f"{value_text(value)} {unit}".rstrip()
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
