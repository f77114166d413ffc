"""Mangled descriptions of cameras: each value that is changed changes the scene, or is listed as not used."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from surveysim.descriptions.bolojax import Imported, import_bolojax
from surveysim.runtime.errors import InputError
from tests.fuzz.mangle import NUMBERS, mangled_bytes, mangled_tokens, pick
from tests.fuzz.outcomes import Outcome, check, outcome_of_error

EXAMPLE = Path(__file__).parents[1] / "data" / "bolojax" / "example.yaml"
VALUES = (
    "null",
    "None",
    "[]",
    "{}",
    "[1, 2, 3]",
    "0.3",
    "12 GHz",
    "3 K",
    "x",
    "-1",
    "true",
    "{value: 0.5, errors: 0.1}",
    "{var_type: dist, fname: cam_1.txt}",
    "{var_type: pdf, fname: none.txt}",
    '"\\u202e\\n"',
    *NUMBERS,
)
DEFAULTS = tuple(
    f"instrument.{part}." for part in ("channel_default", "camera_config.default", "optics_config.default")
)
CHANNEL, APERTURE_M = "cam_1/chan_2", 6.0


def prepare(folder: Path) -> tuple[str, Imported]:
    """The text of a good description, and its scene."""
    text = EXAMPLE.read_text()
    (folder / "camera.yaml").write_text(text)
    return text, _imported(folder / "camera.yaml")


def _imported(path: Path) -> Imported:
    return import_bolojax(path, name="mine", channel=CHANNEL, aperture_m=APERTURE_M)


def mangled(base: tuple[str, Imported], rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A description with another value, other tokens or other bytes."""
    text, scene = base
    (Path("cam_1.txt")).write_bytes((EXAMPLE.parent / "cam_1.txt").read_bytes())
    how = rng.random()
    if how < 0.7:
        changed = _with_another_value(text, rng).encode()
    else:
        changed = (
            mangled_tokens(text, rng).encode("utf-8", "replace") if how < 0.85 else mangled_bytes(text.encode(), rng)
        )
    Path("camera.yaml").write_bytes(changed)
    return changed.decode("utf-8", "replace"), lambda: tried(text, scene)


def _with_another_value(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines()
    place = pick(rng, [number for number, line in enumerate(lines) if ":" in line and not line.startswith("#")])
    line = lines[place]
    begin = pick(rng, [number for number, character in enumerate(line) if character == ":"])
    ends = [end for end in (line.find(",", begin), line.find("}", begin)) if end >= 0]
    lines[place] = f"{line[: begin + 1]} {pick(rng, VALUES)}{line[min(ends) :] if ends else ''}"
    return "\n".join(lines) + "\n"


def leaves(content: Any, key: str = "") -> dict[str, Any]:
    """Scalars by dotted key; null ones aside."""
    if isinstance(content, dict | list):
        pairs = content.items() if isinstance(content, dict) else enumerate(content)
        found = {}
        for name, item in pairs:
            found |= leaves(item, f"{key}.{name}" if key else str(name))
        return found
    return {} if content in ("", "~", "null", "None", "none") else {key: content}


def tried(text: str, scene: Imported) -> Outcome:
    """Import it: refused in one line for each error, or no field is dropped in silence."""
    try:
        found = _imported(Path("camera.yaml"))
    except InputError as error:
        first = str(error).splitlines()[0]
        return outcome_of_error(InputError(first), (InputError,))
    before = leaves(yaml.load(text, yaml.BaseLoader))
    after = leaves(yaml.load(Path("camera.yaml").read_text("utf-8-sig"), yaml.BaseLoader))
    changed = {key for key in after if after[key] != before.get(key)}
    listed = [line.partition(": ")[0] for line in found.unused]
    body = found.text.partition("\ntitle")[2]
    if body == scene.text.partition("\ntitle")[2]:
        for key in changed:
            known = _is_same(before.get(key), after[key]) or any(_within(key, part) for part in listed)
            check(known or key.startswith(DEFAULTS), f"{key} is lost")  # a default that others replace
    return Outcome("right")


def _is_same(before: Any, after: Any) -> bool:
    try:
        return float(before) == float(after)
    except (TypeError, ValueError):
        return False


def _within(key: str, part: str) -> bool:
    """Whether a key is within a part that is listed; channels are listed by name."""
    camera, _, channel = part.partition("/")
    inside = f".{camera}.chan_config.elements.{channel}." if channel else f".camera_config.elements.{part}."
    return f"{key}.".startswith(f"{part}.") or inside in f".{key}."
