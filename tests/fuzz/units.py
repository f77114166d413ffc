"""A simple reading of quantities, independent of the program's: a number, and a product of known units."""

import math
import re
from fractions import Fraction

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_TERM = re.compile(
    r"\s*([*/.])?\s*(?:(?P<one>1)(?=\s*/)|(?P<name>[A-Za-z]+)(?P<power>(?:\*\*|\^)?(?:-?\d+|\([^()]*\)))?)"
)
_SEXAGESIMAL = re.compile(r"([+-]?)(\d+)([hd])\s*(\d+)m\s*(\d+(?:\.\d*)?)s")
_LIST = re.compile(r"\[([^\]]*)\]\s*(.*)", re.DOTALL)
# Scale in internal units, and the power of each dimension.
_BASE = {
    "rad": (1.0, {"rad": 1}),
    "deg": (math.pi / 180, {"rad": 1}),
    "arcmin": (math.pi / 180 / 60, {"rad": 1}),
    "arcsec": (math.pi / 180 / 3600, {"rad": 1}),
    "mas": (math.pi / 180 / 3600e3, {"rad": 1}),
    "hourangle": (math.pi / 12, {"rad": 1}),
    "sr": (1.0, {"rad": 2}),
    "s": (1.0, {"s": 1}),
    "second": (1.0, {"s": 1}),
    "min": (60.0, {"s": 1}),
    "minute": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "hr": (3600.0, {"s": 1}),
    "hour": (3600.0, {"s": 1}),
    "d": (86400.0, {"s": 1}),
    "day": (86400.0, {"s": 1}),
    "yr": (365.25 * 86400.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "m": (1.0, {"m": 1}),
    "K": (1.0, {"K": 1}),
    "W": (1.0, {"W": 1}),
    "J": (1.0, {"W": 1, "s": 1}),
    "dB": (1.0, {"dB": 1}),
    "byte": (1.0, {"byte": 1}),
    "B": (1.0, {"byte": 1}),
    "bit": (0.125, {"byte": 1}),
}
_PREFIXED = ("s", "Hz", "m", "K", "W", "J", "rad", "byte", "B", "bit", "arcsec")
_PREFIX = dict(
    zip(
        "yzafpnumcdhkMGTPEZY",
        (-24, -21, -18, -15, -12, -9, -6, -3, -2, -1, 2, 3, 6, 9, 12, 15, 18, 21, 24),
        strict=True,
    )
)
_PREFIX |= {"da": 1, "µ": -6}


class Unreadable(ValueError):
    """Text that this reading does not know."""


def _one(name: str) -> tuple[float, dict[str, int]]:
    if name in _BASE:
        return _BASE[name]
    for length in (1, 2):
        prefix, rest = name[:length], name[length:]
        if prefix in _PREFIX and rest in _PREFIXED:
            scale, dimensions = _BASE[rest]
            return scale * 10.0 ** _PREFIX[prefix], dimensions
    raise Unreadable(f"unit {name!r}")


def unit(text: str) -> tuple[float, dict[str, Fraction]]:
    """Scale and dimensions of a product of units such as ``mK2 rad(-5/3) / Hz``."""
    scale, dimensions, place, text = 1.0, {}, 0, text.strip()
    while place < len(text):
        match = _TERM.match(text, place)
        if match is None or match[1] and not place and match[1] != "/":
            raise Unreadable(f"unit {text!r}")
        place = match.end()
        if match["one"]:
            continue
        power = (match["power"] or "1").lstrip("*^").strip("()")
        exponent = Fraction(power) * (-1 if match[1] == "/" else 1)
        of, parts = _one(match["name"])
        scale *= of ** float(exponent)
        for name, value in parts.items():
            dimensions[name] = dimensions.get(name, 0) + value * exponent
    return scale, {name: value for name, value in dimensions.items() if value}


def quantity(text: object, target: str) -> float:
    """A quantity of a scene file in `target`; raises Unreadable."""
    if isinstance(text, int | float) and not isinstance(text, bool) and not target:
        return float(text)
    if not isinstance(text, str):
        raise Unreadable(repr(text))
    text = text.strip()
    if match := _SEXAGESIMAL.fullmatch(text):
        sign, whole, kind, minutes, seconds = match.groups()
        degrees = (int(whole) + int(minutes) / 60 + float(seconds) / 3600) * (15 if kind == "h" else 1)
        return math.radians(-degrees if sign == "-" else degrees)
    match = _NUMBER.match(text)
    if match is None:
        raise Unreadable(text)
    try:
        scale, dimensions = unit(text[match.end() :])
        of, wanted = unit(target)
    except (ValueError, ZeroDivisionError):
        raise Unreadable(text) from None
    if dimensions != wanted:
        raise Unreadable(f"{text!r} in {target!r}")
    return float(match[0]) * scale / of


def quantities(value: object, target: str) -> list[float]:
    """A list of quantities in `target`, in either form of a scene file; raises Unreadable."""
    if isinstance(value, list):
        return [quantity(item, target) for item in value]
    match = _LIST.fullmatch(value.strip()) if isinstance(value, str) else None
    if match is None:
        raise Unreadable(repr(value))
    return [quantity(f"{item.strip()} {match[2]}", target) for item in match[1].split(",")]
