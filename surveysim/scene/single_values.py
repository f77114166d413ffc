"""Check of a value of one key of a scene, without the rest of the scene."""

from functools import cache
from typing import Annotated, Any

from pydantic import TypeAdapter, ValidationError

from surveysim.scene.error_lines import sections_of, validation_lines
from surveysim.scene.scene import Scene


def wrong_value(key: str, value: Any) -> str:
    """Return the error of a value that no scene can have for this dotted key; empty for others.

    Checks of several keys are left to scenes.
    """
    try:
        _adapter(key).validate_python(value)
    except ValidationError as error:
        return f"{key}: {validation_lines(error, Scene)[0]}"
    return ""


@cache
def _adapter(key: str) -> Any:
    *sections, last = key.split(".")
    fields = [
        field
        for section in sections_of(sections, Scene)
        for name, field in section.model_fields.items()
        if (field.alias or name) == last
    ]
    (field,) = fields
    kind: Any = field.annotation
    for item in field.metadata:
        kind = Annotated[kind, item]
    return TypeAdapter(kind)
