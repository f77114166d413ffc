"""Expressions of a scene's keys, numbers and units, such as ``60 * arcmin / scan.speed``."""

import ast
import math
import operator
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.scene.units import shown

LONGEST = 300
EXPECTED = "numbers, units, keys of the scene, + - * / **, round, floor, ceil, min, max, sqrt, log and exp are allowed"
_OPERATORS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


def _pure(function: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Apply a function of plain numbers to one number, which may be a ratio of units."""
    return lambda value: function(float(_dimensionless(value)))


def _dimensionless(value: Any) -> Any:
    return value.to_value("") if hasattr(value, "unit") else value


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "round": _pure(round),
    "floor": _pure(lambda value: math.floor(value + 1e-9)),
    "ceil": _pure(lambda value: math.ceil(value - 1e-9)),
    "log": _pure(math.log),
    "exp": _pure(math.exp),
    "sqrt": np.sqrt,
    "min": min,
    "max": max,
}


def parse(text: str) -> ast.expr:
    """Parse an expression; raise InputError for anything but `EXPECTED`."""
    try:
        tree = ast.parse(text, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise InputError(f"found {shown(text)}; an expression is expected: {EXPECTED}") from None
    for node in ast.walk(tree):
        _check(node, text)
    return tree


def _check(node: ast.AST, text: str) -> None:
    call = isinstance(node, ast.Call) and ast.unparse(node.func) in FUNCTIONS and not node.keywords
    known = isinstance(node, ast.Name | ast.Attribute | ast.BinOp | ast.UnaryOp | ast.List | ast.expr_context)
    number = isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)
    if not call and not known and not number and type(node) not in _OPERATORS:
        raise InputError(f"found {shown(ast.unparse(node))} in {shown(text)}; {EXPECTED}")


def names(tree: ast.expr) -> set[str]:
    """Dotted names of an expression, functions aside."""
    if isinstance(tree, ast.Name | ast.Attribute):
        return {ast.unparse(tree)}
    parts = tree.args if isinstance(tree, ast.Call) else ast.iter_child_nodes(tree)
    return set().union(*(names(part) for part in parts if isinstance(part, ast.expr)))


def value_of(tree: ast.expr, given: Callable[[str], Any]) -> Any:
    """Evaluate an expression; `given` returns the value of a dotted name, or None for one that may be a unit.

    Raises
    ------
    InputError
        For an unknown name, units that do not fit, and results that are no finite numbers.
    """
    text = ast.unparse(tree)
    try:
        found = _value(tree, given)
        finite = np.isfinite(getattr(found, "value", found)).all()
    except (ArithmeticError, ValueError, TypeError) as error:  # of units that do not fit, too
        raise InputError(f"found {shown(text)}, which has no value ({error})") from None
    if not finite:
        raise InputError(f"found {shown(text)}, which is {found}; a finite number is expected")
    return found


def _value(node: ast.expr, given: Callable[[str], Any]) -> Any:
    if isinstance(node, ast.Constant):
        return float(str(node.value))  # large powers overflow, and take no time
    if isinstance(node, ast.Name | ast.Attribute):
        name = ast.unparse(node)
        found = given(name)
        return unit(name) if found is None else found
    if isinstance(node, ast.List):
        return np.array([_value(item, given) for item in node.elts])
    if isinstance(node, ast.Call):
        return FUNCTIONS[ast.unparse(node.func)](*(_value(item, given) for item in node.args))
    if isinstance(node, ast.UnaryOp):
        return _OPERATORS[type(node.op)](_value(node.operand, given))
    assert isinstance(node, ast.BinOp)
    return _OPERATORS[type(node.op)](_value(node.left, given), _value(node.right, given))


def unit(name: str) -> Any:
    """Return the unit of a name as a quantity; InputError for a name of none."""
    import astropy.units as u

    try:
        return u.Quantity(1.0, u.Unit(name))
    except ValueError:
        raise InputError(f"found {shown(name)}; a key of the scene that has a value, or a unit, is expected") from None


def quantity_of(value: Any) -> Any:
    """Convert a value of a scene file to a number, or an astropy quantity; InputError for other values."""
    import astropy.units as u

    if isinstance(value, int | float):
        return value
    try:
        return float(Fraction(value))
    except (TypeError, ValueError, ZeroDivisionError):
        pass
    try:
        if isinstance(value, str) and value.lstrip().startswith("["):
            numbers, _, unit = value.strip()[1:].partition("]")
            return u.Quantity([float(item) for item in numbers.split(",")], unit.strip())
        return u.Quantity(value)
    except (TypeError, ValueError):
        raise InputError(f"found {shown(value)}; a number or a quantity is expected") from None


def key_value(content: Mapping[str, Any], key: str) -> Any:
    """Return the value at a dotted key of nested tables; None without one, or for a table."""
    for name in key.split("."):
        content = content.get(name) if isinstance(content, dict) else None
    return None if isinstance(content, dict) else content
