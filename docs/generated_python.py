"""The parts of the guide that come from the source when it is built: public functions and classes, and all modules."""

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).parent.parent
PACKAGES = ("surveysim", "mapmaker")
CALL_WIDTH = 84
SIMPLE = (bool, int, float, str, tuple, type(None))


def api_reference() -> str:
    """Markdown: for each public name of both packages its call and its docstring."""
    parts = []
    for package in map(importlib.import_module, PACKAGES):
        parts += [f"## {package.__name__}", *(_entry(package, name) for name in package.__all__ if name[0] != "_")]
    return "\n\n".join(parts)


def module_reference() -> str:
    """Markdown: for each package a table of its modules with the first sentence of their docstrings."""
    parts, folder = [], None
    for path in sorted(_modules(), key=lambda path: (path.parent, path.name)):
        if path.parent != folder:
            folder = path.parent
            parts += [f"\n### `{folder.relative_to(ROOT)}/`\n\n{_summary(folder / '__init__.py')}\n"]
            parts += ["| module | content |\n|---|---|"]
        parts += [f"| `{path.name}` | {_summary(path)} |"]
    return "\n".join(parts)


def _entry(package: ModuleType, name: str) -> str:
    item = getattr(package, name)
    text = markdown(inspect.cleandoc(item.__doc__ or ""))
    return f"### `{package.__name__}.{name}`\n\n```python\n{_call(name, item)}\n```\n\n{text}"


def markdown(docstring: str) -> str:
    """A docstring in numpy style as Markdown: sections in bold, each item of a section in a list."""
    lines, found, item, in_section = docstring.splitlines(), [], False, False
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        text = escaped(line.strip())
        if re.fullmatch(r"-{3,}", line):
            continue
        if re.fullmatch(r"-{3,}", following):
            in_section, item = True, False
            found += ["", f"**{text}**", ""]
        elif in_section and line and not line[0].isspace():
            item = True
            found.append(f"- {text}")
        else:
            found.append(f"  {text}" if item else text)
    return "\n".join(found)


def escaped(text: str) -> str:
    """A line whose marks of Markdown are letters, outside of code."""
    parts = re.split(r"(`+[^`]+`+)", text)
    return "".join(
        part if number % 2 else re.sub(r"([\\\[\]<>*_$#|])", r"\\\1", part) for number, part in enumerate(parts)
    )


def _call(name: str, item: Any) -> str:
    """A call with the names of all parameters, and defaults that are short."""
    if inspect.isclass(item) and issubclass(item, Exception):
        return f"raise {name}(message)"
    words, keyword_only = [], False
    for parameter in inspect.signature(item).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword_only:
            keyword_only = True
            words.append("*")
        default = parameter.default
        if default is parameter.empty:
            words.append(parameter.name)
        else:
            words.append(f"{parameter.name}={default!r}" if isinstance(default, SIMPLE) else f"{parameter.name}=...")
    return textwrap.fill(f"{name}({', '.join(words)})", CALL_WIDTH, subsequent_indent=" " * (len(name) + 1))


def _modules() -> Iterator[Path]:
    for package in PACKAGES:
        yield from (path for path in (ROOT / package).rglob("*.py") if not path.name.startswith("__"))


def _summary(path: Path) -> str:
    """The first paragraph of a module's docstring, on one line; nothing for a folder that is no package."""
    if not path.exists():
        return ""
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return escaped(" ".join(text.partition("\n\n")[0].split()))
