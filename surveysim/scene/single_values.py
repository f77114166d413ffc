"""Check of a value of one key of a scene, without the rest of the scene."""

from functools import cache
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import TypeAdapter, ValidationError

from surveysim.scene.error_lines import sections_of, validation_lines
from surveysim.scene.scene import Scene


def wrong_value(key: str, value: Any) -> str:
    """Return the error of a value that no scene can have for this dotted key; empty for others.

    Checks of several keys are left to scenes.
    """
    errors = []
    for adapter in _adapters(key):
        try:
            adapter.validate_python(value)
        except ValidationError as error:
            errors.append(f"{key}: {validation_lines(error, Scene)[0]}")
        else:
            return ""
    return errors[0]


@cache
def _adapters(key: str) -> tuple[Any, ...]:
    """Types of a key: several where a section has several classes, but one for the names that choose among them."""
    *sections, last = key.split(".")
    found: list[Any] = []
    for section in sections_of(sections, Scene):
        for name, field in section.model_fields.items():
            if (field.alias or name) == last:
                kind: Any = field.annotation
                for item in field.metadata:
                    kind = Annotated[kind, item]
                found.append(kind)
    if found and all(get_origin(kind) is Literal for kind in found):
        found = [Literal[tuple(name for kind in found for name in get_args(kind))]]
    return tuple(map(TypeAdapter, found))
