"""Errors of a configuration: one line each, with key, value found and values expected."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from mapmaker.pipeline.config_types import Section, shown

_MOST = 30  # lines
_EXPECTED = {
    "model_type": "a section is expected",
    "model_attributes_type": "a section is expected",
    "tuple_type": "a list is expected",
    "string_type": "a text in quotes is expected",
    "int_type": "an integer is expected",
    "float_type": "a number is expected",
    "finite_number": "a finite number is expected",
}


def error_lines(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """Return a line for each error that the schema `model` finds; beyond 30 they are counted only."""
    found = _without_consequences(error.errors(include_url=False))
    lines = [_line(item, model) for item in found[:_MOST]]
    return [*lines, f"{len(found) - _MOST} more errors"] if len(found) > _MOST else lines


def _without_consequences(errors: list[Any]) -> list[Any]:
    """Drop lists that are too short because of items with errors of their own."""
    lists = {item["loc"][:end] for item in errors for end in range(len(item["loc"])) if item["type"] != "too_short"}
    return [item for item in errors if item["type"] != "too_short" or item["loc"] not in lists]


def _line(item: Any, model: type[BaseModel]) -> str:
    key = _key(item["loc"], model)
    message = item["msg"].removeprefix("Value error, ")
    if item["type"] == "extra_forbidden":
        message = _unknown(item["loc"], model)
    elif item["type"] in ("missing", "union_tag_not_found"):
        key = f"{key}.algorithm" if item["type"] != "missing" else key
        message = "missing; this key is expected"
    elif item["type"] == "union_tag_invalid":
        key, allowed = f"{key}.algorithm", item["ctx"]["expected_tags"].replace("'", '"')
        message = f"found {shown(item['ctx']['tag'])}; {allowed} are allowed"
    elif item["type"] == "value_error":
        if named := re.match(r"([a-z_]+): ", message):  # a check of a whole section names the key that it is about
            key, message = f"{key}.{named[1]}".lstrip("."), message[named.end() :]
    else:
        message = f"found {shown(item['input'])}; {_expected(item, message)}"
    return f"{key}: {message}" if key else message


def _expected(item: Any, message: str) -> str:
    message = re.sub(r"^Input should be (greater|less)(.*)$", r"a number \1\2 is expected", message)
    message = re.sub(r"^Input should be ('.*')$", r"\1 is expected", message)
    if item["type"] in ("too_short", "too_long"):
        limits = item["ctx"]
        bound = f"{limits['min_length']} or more" if "min_length" in limits else f"{limits['max_length']} or fewer"
        return f"{bound} items are expected"
    if item["type"] == "missing_argument":
        return "more items are expected"
    return _EXPECTED.get(item["type"], f"{message[0].lower()}{message[1:]}")


def _key(location: tuple[str | int, ...], model: type[BaseModel]) -> str:
    """Dotted key of a location, without the names of the alternatives of a section."""
    parts = []
    for place, part in enumerate(location):
        is_tag = place > 0 and location[0] == "cleaning" and place == 2 and isinstance(part, str)
        if not is_tag:
            parts.append(str(part) if re.fullmatch(r"[\w-]+", str(part)) else shown(str(part)))
    return ".".join(parts)


def _unknown(location: tuple[str | int, ...], model: type[BaseModel]) -> str:
    allowed = sorted(_keys(location[:-1], model))
    close = get_close_matches(str(location[-1])[:100], allowed)
    return (
        f"unknown key; did you mean {' or '.join(close)}?" if close else f"unknown key; allowed are {_joined(allowed)}"
    )


def _joined(names: Iterable[str]) -> str:
    return ", ".join(names)


def _keys(location: tuple[str | int, ...], model: type[BaseModel]) -> set[str]:
    """Keys of the section at a location."""
    found: list[type[BaseModel]] = [model]
    for name in location:
        if isinstance(name, int):
            continue
        of_name = [item.model_fields[name] for item in found if name in item.model_fields]
        if of_name:
            found = [item for field in of_name for item in _sections(field.annotation)]
        else:  # the tag of an alternative
            found = [item for item in found if name in get_args(item.model_fields["algorithm"].annotation)]
    return {key for item in found for key in item.model_fields}


def _sections(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return [annotation]
    return [item for part in get_args(annotation) for item in _sections(part)]
