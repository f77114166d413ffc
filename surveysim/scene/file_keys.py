"""Keys of a scene whose value can be the name of a file."""

from collections.abc import Iterable, Iterator
from functools import cache
from typing import Any, get_args

from pydantic import WithJsonSchema

from surveysim.scene.fields import FILE
from surveysim.scene.scene import Scene
from surveysim.scene.section import Section


@cache
def file_keys() -> tuple[str, ...]:
    """Return the dotted names of all keys whose value can be the name of a file."""
    return tuple(dict.fromkeys(_of_section(Scene, "")))  # several classes have some in common


def _of_section(section: type[Section], before: str) -> Iterator[str]:
    for name, field in section.model_fields.items():
        key, parts = f"{before}{field.alias or name}", list(_parts((field.annotation, *field.metadata)))
        schemas = [part.json_schema or {} for part in parts if isinstance(part, WithJsonSchema)]
        if any(schema.get("format") == FILE for schema in schemas):
            yield key
        for part in parts:
            if isinstance(part, type) and issubclass(part, Section) and part is not Scene:  # of other bands
                yield from _of_section(part, f"{key}.")


def _parts(kinds: Iterable[Any]) -> Iterator[Any]:
    """List types with all their parts and annotations."""
    for kind in kinds:
        yield kind
        yield from _parts(get_args(kind))
