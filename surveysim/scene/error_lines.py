"""Error messages of a scene: one line for each error, with file, key, value found and values expected."""

import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from surveysim.runtime.text_files import key_text
from surveysim.scene.section import Section
from surveysim.scene.similar_names import did_you_mean, similar_names
from surveysim.scene.unions import is_tag, of_tag
from surveysim.scene.units import shown

MAX_ERRORS = 30  # lines of an error
MOST_BELOW = 3  # keys of inner sections that are suggested
HIDDEN_KEYS = ("assumed", "band")  # attributes of a scene that are no keys of its file
_EXPECTED = {
    "model_type": "a section is expected",
    "tuple_type": "a list is expected",
    "string_type": "a text in quotes is expected",
    "int_type": "an integer is expected",
    "int_parsing": "an integer is expected",
    "int_from_float": "an integer is expected",
    "float_type": "a number is expected",
    "float_parsing": "a number is expected",
    "finite_number": "a finite number is expected",
    "string_pattern_mismatch": "ASCII letters, digits, '_', '.' and '-' are expected, neither of the last two first",
}


def error_lines(path: Path, errors: Sequence[str]) -> str:
    """Join errors, each on a line after the path of the file; beyond `MAX_ERRORS` they are counted only."""
    left_out = len(errors[MAX_ERRORS:])
    more = [f"{left_out} more errors"] if left_out else []
    return "\n".join(f"{path}: {line}" for line in [*errors[:MAX_ERRORS], *more])


def validation_lines(error: ValidationError, scene: type[BaseModel]) -> list[str]:
    """Return a line for each error that the schema `scene` finds in a file."""
    found = _without_consequences(_of_known_site(_without_mistyped(error.errors(include_url=False))))
    # A line quotes a value: of many errors only those that are shown are put into words.
    return [_line(item, scene) if number < MAX_ERRORS else "" for number, item in enumerate(found)]


def _without_mistyped(errors: Sequence[Any]) -> list[Any]:
    """Drop missing keys that an unknown key of the same section resembles: its line suggests them."""
    unknown = [item["loc"] for item in errors if item["type"] == "extra_forbidden"]

    def is_mistyped(loc: tuple[str | int, ...]) -> bool:
        return any(
            other[:-1] == loc[:-1] and similar_names(str(other[-1]), [str(loc[-1])]) for other in unknown[:MAX_ERRORS]
        )

    return [item for item in errors if item["type"] != "missing" or not is_mistyped(item["loc"])]


def _of_known_site(errors: Sequence[Any]) -> Sequence[Any]:
    """Drop missing keys that a site may supply, where the name of the site is wrong."""
    if not any(item["loc"] == ("atmosphere", "site") for item in errors):
        return errors
    return [item for item in errors if item["type"] != "missing" or item["loc"][0] not in ("atmosphere", "schedule")]


def _without_consequences(errors: Sequence[Any]) -> list[Any]:
    """Drop lists that are too short because of items with errors of their own."""
    lists = {item["loc"][:end] for item in errors for end in range(len(item["loc"])) if item["type"] != "too_short"}
    return [item for item in errors if item["type"] != "too_short" or item["loc"] not in lists]


def unknown_key(key: str, scene: type[BaseModel], hidden: Collection[str] = ()) -> str:
    """Say that a dotted key is unknown, with similar keys, keys of this name in inner sections, or all of its section.

    Parameters
    ----------
    key
        Dotted key of the file.
    scene
        Schema of the file.
    hidden
        Keys that are not allowed here, although the schema has them.
    """
    *section, name = key.split(".")
    allowed = [item for item in allowed_keys(section, scene) if item not in hidden]
    if not allowed:
        return "unknown key of a scene"
    where = ".".join(part for part in section if not is_tag(part))
    suggestion = did_you_mean(name, allowed, where)
    below = [] if suggestion else [f"{where}.{other}".lstrip(".") for other in _keys_below(name, scene, section)]
    if 0 < len(below) <= MOST_BELOW:
        suggestion = f"did you mean {' or '.join(below)}?"
    return f"unknown key; {suggestion or 'allowed are ' + ', '.join(allowed)}"


def _keys_below(name: str, scene: type[BaseModel], section: Sequence[str]) -> Iterator[str]:
    """Yield the keys of a name in the sections within a section, by their dotted name in it."""
    for part in allowed_keys(section, scene):
        inner = [*section, part]
        if name in allowed_keys(inner, scene):
            yield f"{part}.{name}"
        yield from (f"{part}.{found}" for found in _keys_below(name, scene, inner))


def _line(item: Any, scene: type[BaseModel]) -> str:
    key = key_text(".".join(str(part) for part in item["loc"] if not is_tag(part)))
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "value_error" and (match := re.match(r"([a-z_0-9]+(?:\.[a-z_0-9]+)*): ", message)) and key:
        # A check of a whole section names the key that it is about.
        key, message = f"{key}.{match[1]}", message[match.end() :]
    if item["type"] == "extra_forbidden":
        message = unknown_key(".".join(str(part) for part in item["loc"] if isinstance(part, str)), scene)
    elif item["type"] == "missing":
        message = f"missing; this {'section' if sections_of(item['loc'], scene) else 'key'} is expected"
    elif item["type"] != "value_error":
        message = re.sub(r"^Input should be (greater|less)(.*)$", r"a number \1\2 is expected", message)
        message = re.sub(r"^Input should be ('.*')$", r"\1 is expected", message)
        message = _number_of_items(item) or message
        allowed = _EXPECTED.get(item["type"], f"{message[0].lower()}{message[1:]}")
        message = f"found {shown(item['input'])}; {allowed}"
    return f"{key}: {message}" if key else message


def _number_of_items(item: Any) -> str:
    """Say how many items of a list are expected; empty for other errors."""
    if item["type"] not in ("too_short", "too_long"):
        return ""
    limits = item["ctx"]
    bound = f"{limits['min_length']} or more" if "min_length" in limits else f"{limits['max_length']} or fewer"
    return f"{bound} items are expected, not {limits['actual_length']}"


def allowed_keys(location: Sequence[str | int], scene: type[BaseModel]) -> list[str]:
    """Return the keys of the section at a location of the file, in alphabetical order; none without such a section."""
    found = sections_of(location, scene)
    keys = {field.alias or key for item in found for key, field in item.model_fields.items()}
    return sorted(keys - set(HIDDEN_KEYS))


def sections_of(location: Sequence[str | int], scene: type[BaseModel]) -> list[Any]:
    """Return the classes of the section at a location of the file, several where a key chooses among them."""
    found: list[Any] = [scene]
    for name in location:
        if isinstance(name, int):
            continue
        if is_tag(name):
            found = of_tag(name, found)
        else:
            fields = [pair for item in found for pair in item.model_fields.items()]
            of_name = [field for key, field in fields if (field.alias or key) == name]
            found = [item for field in of_name for item in _sections(field.annotation)]
    return found


def _sections(annotation: Any) -> list[type[Section]]:
    """Classes of sections in a type."""
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return [annotation]
    return [item for part in get_args(annotation) for item in _sections(part)]
