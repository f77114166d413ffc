"""The values that a scene file may hold: quantities, angles, dates, names, and how each is refused.

Every type turns what the file says into a float in internal units (or a checked name), and raises
ValueError with what was found and what is expected.
"""

import math
from datetime import date, time
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from surveysim.sites import SITES
from surveysim.units import to_float, to_floats, to_sky_angle


def shown(value: object) -> str:
    """A value of a scene file as an error quotes it, cut to a line's length."""
    text = str(value) if isinstance(value, date | time) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def quantity(
    unit: str, above: float | None = None, at_least: float | None = None, most_deg: float | None = None
) -> BeforeValidator:
    """A string with a unit to a float in `unit`, within bounds given in it (`most_deg` in degrees)."""

    def check(value: object) -> float | None:
        if value is None:
            return None
        number = to_float(value, unit)
        if above is not None and not number > above:
            raise ValueError(f"found {value!r}; a value above {above:g} is expected")
        if at_least is not None and not number >= at_least:
            raise ValueError(f"found {value!r}; a value of {at_least:g} or more is expected")
        if most_deg is not None and not number <= math.radians(most_deg) * (1 + 1e-12):
            raise ValueError(f"found {value!r}; {most_deg:g} deg or less is expected")
        return number

    return BeforeValidator(check)


def _fraction(value: object) -> object:
    try:
        return float(Fraction(value)) if isinstance(value, str) else value
    except (ValueError, ZeroDivisionError, OverflowError):
        raise ValueError(f"found {value!r}; a number or a fraction like '11/3' is expected") from None


def _latitude(value: object) -> float:
    angle = to_sky_angle(value)
    if abs(angle) > math.pi / 2:
        raise ValueError(f"found {value!r}; -90 deg to 90 deg is expected")
    return angle


def _longitude(value: object) -> float:
    angle = to_sky_angle(value)
    if abs(angle) > 2 * math.pi:
        raise ValueError(f"found {value!r}; -360 deg to 360 deg is expected")
    return angle


def _date(value: object) -> str:
    try:
        return date.fromisoformat(value).isoformat()
    except (TypeError, ValueError):
        raise ValueError(f"found {shown(value)}; a date in quotes like '2003-10-28' is expected") from None


def _nside(value: object) -> object:
    # healpy ends the whole process for another one.
    if value is not None and value not in [2**k for k in range(14)]:
        raise ValueError(f"found {shown(value)}; a power of two from 1 to 8192 is expected")
    return value


def _file(value: object) -> object:
    if value is not None and (not isinstance(value, str) or not value or "\0" in value):
        raise ValueError(f"found {shown(value)}; the name of an ECSV file is expected")
    return value


def _steps(value: object) -> object:
    from mapmaker.cleaning import CLEANERS

    steps = value if isinstance(value, list | tuple) else [value]
    for name in steps or [value]:
        if not isinstance(name, str) or name not in CLEANERS:
            raise ValueError(f"found {shown(name)}; one of {', '.join(map(repr, CLEANERS))} is expected")
    return tuple(steps)


def _site(value: object) -> object:
    if value is not None and value not in SITES:
        raise ValueError(f"found {shown(value)}; one of {', '.join(map(repr, SITES))} is expected")
    return value


def pairs(value: object) -> object:
    """A table of the file as pairs."""
    return tuple(value.items()) if isinstance(value, dict) else value  # a scene is hashable, a dict is not


Angle = Annotated[float, quantity("rad")]
PositiveAngle = Annotated[float, quantity("rad", above=0)]
AngleExtent = Annotated[float, quantity("rad", at_least=0)]
BeamWidth = Annotated[float, quantity("rad", above=0, most_deg=30)]
Elevation = Annotated[float, quantity("rad", above=0, most_deg=90)]
ElevationLimit = Annotated[float, quantity("rad", at_least=0, most_deg=90)]
HourAngle = Annotated[float, quantity("rad", above=0, most_deg=180)]
Longitude = Annotated[float, BeforeValidator(_longitude)]
Latitude = Annotated[float, BeforeValidator(_latitude)]
IsoDate = Annotated[str, BeforeValidator(_date)]
Nside = Annotated[int | None, BeforeValidator(_nside)]
SiteName = Annotated[str | None, BeforeValidator(_site)]
TableFile = Annotated[Path | None, BeforeValidator(_file)]
Speed = Annotated[float, quantity("rad / s", above=0)]
SpeedExtent = Annotated[float, quantity("rad / s", at_least=0)]
Duration = Annotated[float, quantity("s", above=0)]
DurationExtent = Annotated[float, quantity("s", at_least=0)]
Height = Annotated[float, quantity("m")]
Length = Annotated[float, quantity("m", above=0)]
Frequency = Annotated[float, quantity("Hz", above=0)]
NoisePsd = Annotated[float, quantity("mK2 / Hz", at_least=0)]
Temperature = Annotated[float, quantity("mK")]
Load = Annotated[float, quantity("K", at_least=0)]
Nep = Annotated[float, quantity("W / Hz(1/2)", at_least=0)]
Memory = Annotated[float, quantity("byte", above=0)]
Taper = Annotated[float, quantity("dB", at_least=0)]
BandPowerExtent = Annotated[float, quantity("uK2", at_least=0)]
PositiveBandPower = Annotated[float, quantity("uK2", above=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Index = Annotated[float, BeforeValidator(_fraction), Field(gt=0, allow_inf_nan=False)]
Variances = Annotated[tuple[float, ...], BeforeValidator(lambda value: to_floats(value, "mK2"))]
Waters = Annotated[tuple[float, ...], BeforeValidator(lambda value: to_floats(value, "mm"))]
Coherence = Literal["field", "intensity", "none"]
Steps = Annotated[tuple[str, ...], BeforeValidator(_steps)]
