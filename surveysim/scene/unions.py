"""Sections of several classes: the value of one key, such as `kind`, chooses among them."""

from collections.abc import Sequence
from functools import reduce
from operator import or_
from typing import Annotated, Any, get_args

from pydantic import BeforeValidator, Discriminator, Tag

from surveysim.scene.section import Section
from surveysim.scene.units import shown

CHOOSING_KEYS = ("kind", "pattern")


def union_of(sections: Sequence[type[Section]], key: str, default: str | None = None) -> Any:
    """Make the type of a section whose `key`, a literal in each class, chooses the class.

    Parameters
    ----------
    sections
        The classes.
    key
        One of `CHOOSING_KEYS`.
    default
        Value of a section without the key; None where the key is required.
    """
    known = {choice(item, key): item for item in sections}

    def tag(value: Any) -> str:
        return f"{key}={_value(value, key, default)}"

    def check(value: Any) -> Any:
        found = _value(value, key, default)
        if not isinstance(found, str) or found not in known:
            expected = f"one of {', '.join(map(repr, known))} is expected"
            raise ValueError(f"{key}: {'missing' if found is None else f'found {shown(found)}'}; {expected}")
        return value

    tagged = (Annotated[item, Tag(f"{key}={name}")] for name, item in known.items())
    return Annotated[reduce(or_, tagged), Discriminator(tag), BeforeValidator(check)]


def _value(section: Any, key: str, default: str | None) -> Any:
    return section.get(key, default) if isinstance(section, dict) else getattr(section, key, default)


def choice(section: type[Section], key: str) -> str:
    """Return the value of the choosing key that asks for a class."""
    return str(get_args(section.model_fields[key].annotation)[0])


def is_tag(part: str | int) -> bool:
    """Return whether a part of an error's location names the class of a section, and no key of the file."""
    return str(part).partition("=")[0] in CHOOSING_KEYS and "=" in str(part)


def of_tag(part: str, sections: Sequence[type[Section]]) -> list[type[Section]]:
    """Return the class that a tag names, as a list."""
    key, _, value = part.partition("=")
    return [item for item in sections if value in get_args(item.model_fields[key].annotation)]
