"""Conversion of quantities in a scene file to internal units, and of temperatures.

Internal units are radians, seconds, hertz, metres and millikelvin (Rayleigh-Jeans). All conversion happens here.
"""

import math
import re
from datetime import date, time
from fractions import Fraction
from functools import lru_cache
from typing import Any

from surveysim.runtime.errors import InputError

PLANCK_J_S = 6.62607015e-34
BOLTZMANN_J_K = 1.380649e-23
LIGHT_M_S = 299792458.0
CMB_TEMPERATURE_K = 2.7255
LONGEST_QUANTITY = 200  # characters of one number and its unit
_SEXAGESIMAL = re.compile(r"\s*([+-]?)(\d{1,6})([hd])\s*(\d{1,6})m\s*(\d{1,6}(?:\.\d*)?)s\s*", re.ASCII)
_LIST = re.compile(r"^\s*\[(?P<values>[^\]]*)\]\s*(?P<unit>.*)$", re.DOTALL)
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
# A unit is a product of names with powers, divided by one name at most: astropy alone reads "4 4 s" as 16 s.
_POWER = r"(?:(?:\s?(?:\^|\*\*)\s?)?(?:-?\d{1,2}|\(\s*-?\d{1,6}(?:\.\d{1,6}|\s*/\s*\d{1,4})?\s*\)))?"
_NAME = rf"[A-Za-z\u00b5\u03bc]+{_POWER}"
_UNIT = rf"%|{_NAME}(?:(?:\s?[*.]\s?|\s){_NAME})*(?:\s?/\s?{_NAME})?|/\s?{_NAME}"
_QUANTITY = re.compile(rf"\s*(?P<number>{NUMBER})\s*(?P<unit>{_UNIT})?\s*", re.ASCII)
# Factors of the units that scenes use most, as astropy has them; it takes 0.25 s to import, and knows all others.
_COMMON = {
    "": {"%": 0.01},
    "rad": {
        "deg": 0.017453292519943295,
        "arcmin": 0.0002908882086657216,
        "arcsec": 4.84813681109536e-06,
        "hourangle": 0.2617993877991494,
    },
    "rad / s": {
        "deg / s": 0.017453292519943295,
        "arcmin / s": 0.0002908882086657216,
        "arcsec / s": 4.84813681109536e-06,
    },
    "rad / s2": {
        "deg / s2": 0.017453292519943295,
        "arcmin / s2": 0.0002908882086657216,
        "arcsec / s2": 4.84813681109536e-06,
    },
    "rad / s3": {
        "deg / s3": 0.017453292519943295,
        "arcmin / s3": 0.0002908882086657216,
        "arcsec / s3": 4.84813681109536e-06,
    },
    "s": {"us": 1e-06, "ms": 0.001, "min": 60.0, "h": 3600.0, "day": 86400.0},
    "Hz": {"kHz": 1000.0, "MHz": 1000000.0, "GHz": 1000000000.0, "THz": 1000000000000.0, "/ s": 1.0},
    "m": {"mm": 0.001, "cm": 0.01, "km": 1000.0},
    "mK": {"K": 1000.0},
    "K": {"mK": 0.001},
    "W / K": {"nW / K": 1e-09, "pW / K": 1e-12},
    "J": {"eV": 1.602176634e-19, "meV": 1.6021766339999998e-22},
    "byte": {"kB": 1000.0, "MB": 1000000.0, "GB": 1000000000.0},
}
_NOT_FINITE = re.compile(r"\s*[+-]?(?:nan|inf|infinity)\b.*", re.ASCII | re.IGNORECASE | re.DOTALL)


def shown(value: object) -> str:
    """Quote a value of a scene file for an error message, cut to 60 characters."""
    try:
        text = str(value) if isinstance(value, date | time) else repr(value)
    except (RecursionError, ValueError):  # lists within lists, integers of thousands of digits
        text = f"a value of type {type(value).__name__} that is too long to show"
    return text if len(text) <= 60 else f"{text[:57]}..."


def to_float(text: object, unit: str, usual: str = "") -> float:
    """Convert a quantity, one number and one unit such as ``"4 arcmin / s"``, to a unit.

    Parameters
    ----------
    text
        The quantity; a bare number only where `unit` is "".
    unit
        Unit of the result, as astropy writes it.
    usual
        Unit that messages suggest; by default `unit`.

    Raises
    ------
    InputError
        With the value found and the values expected.
    """
    usual = usual or unit
    if isinstance(text, bool) or not isinstance(text, int | float | str):
        raise InputError(f"found {shown(text)}; a quantity in {usual or 'plain numbers'} is expected")
    if isinstance(text, int | float):
        if unit:
            raise InputError(f"found the bare number {shown(text)}; a string with a unit like {usual!r} is expected")
        try:
            return _finite(float(text), text)
        except OverflowError:  # too large an integer
            return _finite(math.inf, text)
    match = _QUANTITY.fullmatch(text) if len(text) <= LONGEST_QUANTITY else None
    if match is None:
        if _NOT_FINITE.fullmatch(text):
            _finite(math.inf, text)
        raise InputError(f"found {shown(text)}; one number and one unit like {usual or '1'!r} are expected")
    factor = _unit_factor(match["unit"] or "", unit)
    if factor is None:
        expected = f"a quantity in units like {usual!r}" if usual else "a number or a percentage"
        raise InputError(f"found {shown(text)}; {expected} is expected")
    return _finite(float(match["number"]) * factor, text)


@lru_cache(maxsize=256)
def _unit_factor(found: str, unit: str) -> float | None:
    """Conversion factor between units; None where there is none."""
    if found == unit or found in _COMMON.get(unit, ()):
        return 1.0 if found == unit else _COMMON[unit][found]
    import astropy.units as u

    try:
        parsed = u.Unit(found)
        # Magnitudes and other functions are no units.
        return float(parsed.to(unit)) if isinstance(parsed, u.UnitBase) else None
    except (u.UnitConversionError, TypeError, ValueError, ArithmeticError):
        return None


def unit_of(text: object) -> str | None:
    """Return the unit that a quantity is written in; None for anything but one number and one unit."""
    match = _QUANTITY.fullmatch(text) if isinstance(text, str) else None
    return match["unit"] if match else None


def to_floats(text: object, unit: str) -> tuple[float, ...]:
    """Convert quantities, ``"[46, 100, 170] mK2 rad(-5/3)"`` or a TOML list, to a unit; errors as for `to_float`."""
    if isinstance(text, list | tuple):
        return tuple(to_float(item, unit) for item in text)
    match = _LIST.match(text) if isinstance(text, str) else None
    if match is None:
        raise InputError(f"found {shown(text)}; a list like '[1, 2, 3] {unit}' is expected")
    return tuple(to_float(f"{value.strip()} {match['unit']}", unit) for value in match["values"].split(","))


def to_sky_angle(text: object) -> float:
    """Convert ``"08h49m12s"``, ``"+44d50m24s"`` or any angular quantity to radians; errors as for `to_float`."""
    match = _SEXAGESIMAL.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return to_float(text, "rad", "deg")
    sign, whole, unit, minutes, seconds = match.groups()
    if int(minutes) >= 60 or float(seconds) >= 60:
        raise InputError(f"found {shown(text)}; minutes and seconds below 60 are expected")
    degrees = (int(whole) + int(minutes) / 60 + float(seconds) / 3600) * (15 if unit == "h" else 1)
    return math.radians(-degrees if sign == "-" else degrees)


def _finite(value: float, found: object) -> float:
    if not math.isfinite(value):
        raise InputError(f"found {shown(found)}; a finite number is expected")
    return value


def b2_unit(spectral_index: float) -> str:
    """Unit of the amplitude of a power spectrum with an index, such as ``mK2 rad(-5/3)``."""
    return f"mK2 rad({Fraction(2 - spectral_index).limit_denominator(1000)})"


def file_value(value: Any) -> Any:
    """Write a value as a scene file does: astropy quantities become text with a unit, numpy's numbers Python's own."""
    if hasattr(value, "to_value") and hasattr(value, "unit"):
        number, unit = value.value.tolist(), value.unit.to_string("generic", fraction=False)
        return f"{number!r} {unit}" if unit else number
    return value.tolist() if hasattr(value, "tolist") else value
