"""Descriptions of the keys of a scene: the docstrings below the fields of its sections, read from the source.

pydantic can read them too, but does so whenever a section is defined: that takes half of the time of a short command.
"""

import ast
import inspect
import sys
from functools import cache
from itertools import pairwise


def field_docs(section: type) -> dict[str, str]:
    """Return the docstrings of the fields of a class and of its bases, by the name of the field."""
    found: dict[str, str] = {}
    for base in reversed(section.__mro__[:-1]):
        found |= _of_module(base.__module__).get(base.__name__, {})
    return found


@cache
def _of_module(name: str) -> dict[str, dict[str, str]]:
    """Return the docstrings of fields by class."""
    tree = ast.parse(inspect.getsource(sys.modules[name]))
    return {node.name: _of_class(node) for node in tree.body if isinstance(node, ast.ClassDef)}


def _of_class(node: ast.ClassDef) -> dict[str, str]:
    return {
        field.target.id: inspect.cleandoc(text.value.value)
        for field, text in pairwise(node.body)
        if isinstance(field, ast.AnnAssign)
        and isinstance(field.target, ast.Name)
        and isinstance(text, ast.Expr)
        and isinstance(text.value, ast.Constant)
        and isinstance(text.value.value, str)
    }
