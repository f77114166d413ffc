"""The parts of the guide that are made when it is built: all keys of a scene or a configuration, all commands."""

import subprocess
import sys
from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Any, Literal, get_args, get_origin

from pydantic.fields import FieldInfo

from mapmaker.pipeline.config import Config
from mapmaker.pipeline.config_types import Kind, Section
from surveysim.scene.keys import key_rows, scene_sections


def scene_reference() -> str:
    """Markdown: for each section of a scene a heading, what it is, and a table of its keys."""
    parts = []
    for section in scene_sections():
        parts += [f"## {section.heading}", *section.introduction]
        rows = [
            f"| `{row.key.rpartition('.')[2]}` | {row.meaning} | {row.kind} | {row.allowed} | {row.default} |"
            for row in key_rows(section)
        ]
        head = "| key | what it is | type and unit | allowed | default |\n|---|---|---|---|---|"
        parts.append("\n".join([head, *rows]))
    return "\n\n".join(parts)


def command_reference(program: str = "surveysim") -> str:
    """Markdown: for each command what it does, its arguments and options, as typer documents them."""
    command = [sys.executable, "-m", "typer", f"{program}.cli.app", "utils", "docs", "--name", program]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return text[text.index(f"## `{program} ") :].replace("```console\n$ ", "```text\n")


def mapmaker_command_reference() -> str:
    """As `command_reference`, of the commands of mapmaker."""
    return command_reference("mapmaker")


def config_reference() -> str:
    """Markdown: for each section of a configuration of `mapmaker clean-and-map` a table of its keys."""
    parts = []
    for heading, section in config_sections():
        head = "| key | meaning | type | default |\n|---|---|---|---|"
        rows = [
            f"| `{name}` | {' '.join((field.description or '').split())} | {_kind(field)} | {_default(field)} |"
            for name, field in section.model_fields.items()
            if name != "algorithm"
        ]
        parts += [f"### {heading}", " ".join((section.__doc__ or "").split())]
        parts += ["\n".join([head, *rows])] if rows else []
    return "\n\n".join(parts)


def config_sections() -> Iterator[tuple[str, type[Section]]]:
    """Headings and sections of a configuration; each cleaning step and each item of a list is one."""
    for name, field in Config.model_fields.items():
        for section in _sections(field.annotation):
            step = section.model_fields.get("algorithm")
            kind = f', `algorithm = "{get_args(step.annotation)[0]}"`' if step else ""
            yield (f"`[[{name}]]`{kind}" if step else f"`[{name}]`"), section
            for key, item in section.model_fields.items():
                for inner in _sections(item.annotation):
                    yield (f"`[{name}.{key}]`" if inner is item.annotation else f"`[[{name}.{key}]]`"), inner


def _sections(annotation: Any) -> list[type[Section]]:
    if isinstance(annotation, type) and issubclass(annotation, Section):
        return [annotation]
    return [item for part in get_args(annotation) for item in _sections(part)]


def _kind(field: FieldInfo) -> str:
    """Name of the type of a key, with its bounds."""
    named = [item.text for item in field.metadata if isinstance(item, Kind)]
    bounds = [
        f"{word} {getattr(item, key):.10g}" for item in field.metadata for key, word in _BOUNDS if hasattr(item, key)
    ]
    return " ".join([named[0] if named else _type(field.annotation), *bounds])


_BOUNDS = (("ge", "from"), ("gt", "above"), ("le", "to"))
_TYPES = {float: "number", int: "integer", str: "text"}


def _type(annotation: Any) -> str:
    """Name of a type."""
    parts = get_args(annotation)
    if _sections(annotation) == [annotation]:
        return "section"
    if get_origin(annotation) is Literal:
        return ", ".join(f'`"{choice}"`' for choice in parts)
    if named := [item.text for item in parts if isinstance(item, Kind)]:
        return named[0]
    if isinstance(annotation, UnionType) or type(None) in parts:
        return _type(next(part for part in parts if part is not NoneType))
    if get_origin(annotation) is tuple:
        if _sections(annotation):
            return "list of sections"
        kinds = [_type(part) for part in parts if part is not Ellipsis]
        return f"list of {kinds[0]}" if len(set(kinds)) == 1 else f"list of {' and '.join(kinds)}"
    if hasattr(annotation, "__metadata__"):  # bounds
        limits = [item for part in annotation.__metadata__ for item in getattr(part, "metadata", [part])]
        words = [f"{word} {getattr(item, key):.10g}" for item in limits for key, word in _BOUNDS if hasattr(item, key)]
        return " ".join([_type(annotation.__origin__), *words])
    return _TYPES[annotation]


def _default(field: FieldInfo) -> str:
    """Default of a key."""
    value = field.default
    if field.is_required():
        return "**required**"
    if value is None or value == () or isinstance(value, Section):
        return ""
    if any(isinstance(item, Kind) and item.text.startswith("time") for item in field.metadata):
        return f'`"{value:g} s"`'
    return f"`{list(value) if isinstance(value, tuple) else value}`".replace("'", '"')
