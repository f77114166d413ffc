"""All keys of a scene, for the reference and the command `keys`: meaning, type, unit, range and default."""

import json
import math
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from surveysim.scene.bands import TABLE
from surveysim.scene.scene import Scene
from surveysim.scene.shipped import shipped_folder
from surveysim.scene.unions import CHOOSING_KEYS
from surveysim.scene.units import to_float, unit_of

LONGEST_EXAMPLE = 44
TYPES = {"integer": "integer", "number": "number", "string": "text", "array": "list", "object": "table"}


@dataclass(frozen=True)
class SceneSection:
    """A section of a scene file: dotted name ("" for the top level), whether it is a list, and its schema.

    `chosen_by` is the key and value that choose among several schemas, as in the file; else it is empty.
    """

    name: str
    several: bool
    required: bool
    description: str
    schema: Mapping[str, Any]
    chosen_by: str = ""

    @property
    def heading(self) -> str:
        """Heading as in the file."""
        if not self.name:
            return "Top of the file"
        chosen = f" `{self.chosen_by}`" if self.chosen_by else ""
        return f"`[[{self.name}]]`{chosen}" if self.several else f"`[{self.name}]`{chosen}"

    @property
    def introduction(self) -> tuple[str, ...]:
        """Paragraphs about the section; none at the top level."""
        if not self.name:
            return ()
        may = "Required." if self.required else "May be left out."
        return self.schema["description"], f"{may} {self.description}".strip()


@dataclass(frozen=True)
class KeyRow:
    """A row of the list of keys, in Markdown: dotted name, meaning, type and unit, allowed values, default."""

    key: str
    meaning: str
    kind: str
    allowed: str
    default: str


@cache
def scene_sections() -> tuple[SceneSection, ...]:
    """List all sections in the order of the schema, each before its subsections."""
    schema = Scene.model_json_schema()
    found: dict[tuple[str, str], SceneSection] = {}
    for section in _walk(schema, SceneSection("", False, True, "", schema)):
        found.setdefault((section.name, section.chosen_by), section)  # several classes have some in common
    return tuple(found.values())


def all_keys() -> dict[str, dict[str, Any]]:
    """Return all keys of a scene by dotted name, with their schema: the first where a key chooses among several."""
    found: dict[str, dict[str, Any]] = {}
    for section in scene_sections():
        for name, item in section_keys(section).items():
            found.setdefault(f"{section.name}.{name}".lstrip("."), item)
    return found


def section_keys(section: SceneSection) -> dict[str, dict[str, Any]]:
    """Return the keys of a section, without subsections, with their schema."""
    keys = {name: _flat(item) for name, item in section.schema["properties"].items()}
    return {name: item for name, item in keys.items() if not _references(item)}


def key_rows(section: SceneSection) -> list[KeyRow]:
    """Return rows of the keys of a section, in the order of the schema."""
    required, keys = section.schema.get("required", ()), section_keys(section)
    return [_row(f"{section.name}.{name}".lstrip("."), item, name in required) for name, item in keys.items()]


# ---------------------------------------------------------------- the schema


def _walk(schema: Mapping[str, Any], section: SceneSection) -> Iterator[SceneSection]:
    yield section
    for name, item in section.schema["properties"].items():
        flat = _flat(item)
        for found in (several := _references(flat)):
            inner = schema["$defs"][found.rpartition("/")[2]]
            full = f"{section.name}.{name}".lstrip(".")
            required = name in section.schema.get("required", ())
            description = flat.get("description", "")
            chosen_by = _chosen_by(inner) if len(several) > 1 else ""
            is_list = flat.get("type") == "array"
            yield from _walk(schema, SceneSection(full, is_list, required, description, inner, chosen_by))


def _chosen_by(schema: Mapping[str, Any]) -> str:
    """Name the key and value that ask for a schema, as in the file."""
    key = next(name for name in CHOOSING_KEYS if "const" in schema["properties"].get(name, {}))
    return f"{key} = {json.dumps(schema['properties'][key]['const'])}"


def _flat(item: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten the schema of an optional key."""
    rest = {key: value for key, value in item.items() if key != "anyOf"}
    for choice in item.get("anyOf", ()):
        if choice.get("type") != "null":
            rest = choice | rest
    return rest


def _references(item: Mapping[str, Any]) -> list[str]:
    """Schemas of the section that a key holds: several where a key chooses among them."""
    one = (item, item.get("items", {}))
    return [found["$ref"] for any_of in one for found in (any_of, *any_of.get("oneOf", ())) if "$ref" in found]


def _row(key: str, item: Mapping[str, Any], required: bool) -> KeyRow:
    example = _examples().get(key) or (json.dumps(item["examples"][0]) if "examples" in item else "")
    item = _in_unit_of(example, item)
    kind = _type(item) + (f", as `{example}`" if example else "")
    meaning = " ".join(item.get("description", "").split())  # a row is a line
    return KeyRow(key, meaning, kind, _allowed(item), _default(item, required))


def _in_unit_of(example: str, item: Mapping[str, Any]) -> Mapping[str, Any]:
    """Express unit, bounds and default in the unit of the example, or in that of the bounds if it is "08h49m12s".

    Angles without an example have the unit of the bounds too.
    """
    if item.get("type") != "string" or "unit" not in item:
        return item
    of_bounds = unit_of(item["at_most"]) if example or item["unit"].startswith("rad") else None
    unit = (example and unit_of(json.loads(example))) or of_bounds or item["unit"]
    own, size = item["unit"], to_float(f"1 {unit}", item["unit"])
    bounds = {
        name: text if unit_of(text) == unit else f"{_rounded(to_float(text, own) / size)} {unit}"
        for name in ("at_least", "at_most")
        if (text := item.get(name))
    }
    default = item.get("default")
    return {**item, "unit": unit, **bounds} | ({"default": default / size} if default else {})


def _rounded(value: float) -> str:
    """Format a number with seven digits if these are exact, else with three."""
    text = f"{value:.7g}"
    return text if math.isclose(float(text), value, rel_tol=1e-12) else f"{value:.3g}"


def _type(item: Mapping[str, Any]) -> str:
    if "enum" in item and item.get("type") == "string":
        return "text"
    kinds = item["type"] if isinstance(item["type"], list) else [item["type"]]
    if "unit" in item and "string" in kinds:
        name = "quantities" if "array" in kinds else "quantity"
    else:
        name = " or ".join(TYPES[kind] for kind in kinds)
    if item["type"] == "array":
        of = item["items"]["type"]
        name += f" of {TYPES[of]}s" if isinstance(of, str) else " of texts or lists"
    return name + (f" in `{item['unit']}`" if "unit" in item else "")


def _allowed(item: Mapping[str, Any]) -> str:
    if "const" in item:
        return f"`{json.dumps(item['const'])}`"
    inner = item.get("items", {})
    choices = item.get("enum") or inner.get("enum") or inner.get("items", {}).get("enum")
    if choices and all(isinstance(choice, int) for choice in choices):
        return f"{choices[0]}, {choices[1]}, {choices[2]}, ... {choices[-1]}"
    if choices:
        return ", ".join(f"`{json.dumps(choice)}`" for choice in choices)
    low, high = item.get("at_least", item.get("minimum")), item.get("at_most", item.get("maximum"))
    if low is not None and high is not None:
        return f"{_number(low)} to {_number(high)}"
    words = {"above {}": item.get("exclusiveMinimum"), "{} or more": low}
    words |= {"below {}": item.get("exclusiveMaximum"), "up to {}": high}
    return ", ".join(text.format(_number(value)) for text, value in words.items() if value is not None)


def _number(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.7g}"


def _default(item: Mapping[str, Any], required: bool) -> str:
    if "otherwise" in item:
        return item["otherwise"]
    if required:
        return "**required**"
    if item["default"] in (None, []):
        return "none"
    if "unit" not in item:
        return f"`{json.dumps(item['default'])}`"
    if isinstance(item["default"], list):
        return f"`[{', '.join(f'{value:g}' for value in item['default'])}] {item['unit']}`"
    return f"`{item['default']:g} {item['unit']}`"


# ---------------------------------------------------------------- examples


def scene_keys(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Return names and values of all keys of a scene file, as those of a scene of one band; without its [sweep]."""
    names = {section.name for section in scene_sections()}
    content = dict(content)
    tables = [("", table) for table in (*content.pop(TABLE, {}).values(), content)]
    while tables:
        section, table = tables.pop(0)
        for name, value in table.items():
            full = f"{section}.{name}".lstrip(".")
            if full in names:
                tables += [(full, item) for item in (value if isinstance(value, list) else [value])]
            elif full != "sweep":
                yield full, value


@cache
def _examples() -> dict[str, str]:
    """Short example value of each key in the scenes that ship, preferably from lynx."""
    found: dict[str, str] = {}
    for path in sorted(shipped_folder().glob("*.toml"), key=lambda path: (path.stem != "lynx", path.stem)):
        for key, value in scene_keys(tomllib.loads(path.read_text(encoding="utf-8"))):
            text = json.dumps(value)
            if key not in found and len(text) <= LONGEST_EXAMPLE:
                found[key] = text
    return found
