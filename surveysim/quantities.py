"""The values that a scene file may hold: quantities, angles, dates, names, and how each is refused.

Every type turns what the file says into a float in internal units (or a checked name), and raises
ValueError with what was found and what is expected.
"""

import math
from datetime import date, time
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from surveysim.sites import SITES
from surveysim.units import to_float, to_floats, to_sky_angle


def shown(value: object) -> str:
    """A value of a scene file as an error quotes it, cut to a line's length."""
    text = str(value) if isinstance(value, date | time) else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def of_file(kind: str | list[str], **facts: object) -> WithJsonSchema:
    """What the schema says of a value as it stands in the file: its type, and its unit, bounds or choices.

    Beside JSON Schema's own words these are `unit`, to which it must convert, and `at_least` and `at_most`, bounds as
    quantities.
    """
    return WithJsonSchema({"type": kind} | {key: fact for key, fact in facts.items() if fact is not None})


def _several(unit: str, example: str) -> WithJsonSchema:
    return of_file(["string", "array"], unit=unit, examples=[example])


def quantity(
    unit: str, above: float | None = None, at_least: float | None = None, at_most: str | None = None
) -> tuple[BeforeValidator, WithJsonSchema]:
    """A string with a unit to a float in `unit`, within bounds given in it (`at_most` as a quantity, "30 deg").

    With what the schema says of it, to be unpacked into an `Annotated` type.
    """

    def check(value: object) -> float | None:
        if value is None:
            return None
        number = to_float(value, unit)
        if above is not None and not number > above:
            raise ValueError(f"found {value!r}; a value above {above:g} is expected")
        if at_least is not None and not number >= at_least:
            raise ValueError(f"found {value!r}; a value of {at_least:g} or more is expected")
        if at_most is not None and not number <= to_float(at_most, unit) * (1 + 1e-12):
            raise ValueError(f"found {value!r}; {at_most} or less is expected")
        return number

    bounds = {"exclusiveMinimum": above, "minimum": at_least, "at_most": at_most}
    return BeforeValidator(check), of_file("string", unit=unit, **bounds)


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


def _steps_of_file(schema: dict[str, object]) -> None:
    """Say in the schema which steps there are: one alone needs no list."""
    from mapmaker.cleaning import CLEANERS

    schema |= {"type": ["string", "array"], "items": {"enum": list(CLEANERS)}}


def _site(value: object) -> object:
    if value is not None and value not in SITES:
        raise ValueError(f"found {shown(value)}; one of {', '.join(map(repr, SITES))} is expected")
    return value


def _pairs(value: object) -> object:
    """A table of the file as pairs."""
    return tuple(value.items()) if isinstance(value, dict) else value  # a scene is hashable, a dict is not


Angle = Annotated[float, *quantity("rad")]
PositiveAngle = Annotated[float, *quantity("rad", above=0)]
AngleExtent = Annotated[float, *quantity("rad", at_least=0)]
BeamWidth = Annotated[float, *quantity("rad", above=0, at_most="30 deg")]
Elevation = Annotated[float, *quantity("rad", above=0, at_most="90 deg")]
ElevationLimit = Annotated[float, *quantity("rad", at_least=0, at_most="90 deg")]
HourAngle = Annotated[float, *quantity("rad", above=0, at_most="180 deg")]
Longitude = Annotated[
    float,
    BeforeValidator(_longitude),
    of_file("string", unit="rad", at_least="-360 deg", at_most="360 deg", examples=["08h49m12s"]),
]
Latitude = Annotated[
    float,
    BeforeValidator(_latitude),
    of_file("string", unit="rad", at_least="-90 deg", at_most="90 deg", examples=["+44d50m24s"]),
]
IsoDate = Annotated[str, BeforeValidator(_date), of_file("string", format="date")]
Nside = Annotated[int | None, BeforeValidator(_nside), of_file("integer", enum=[2**k for k in range(14)])]
SiteName = Annotated[str | None, BeforeValidator(_site), of_file("string", enum=SITES)]
TableFile = Annotated[Path | None, BeforeValidator(_file), of_file("string", examples=["camera.ecsv"])]
Speed = Annotated[float, *quantity("rad / s", above=0)]
SpeedExtent = Annotated[float, *quantity("rad / s", at_least=0)]
Duration = Annotated[float, *quantity("s", above=0)]
DurationExtent = Annotated[float, *quantity("s", at_least=0)]
Height = Annotated[float, *quantity("m")]
Length = Annotated[float, *quantity("m", above=0)]
Frequency = Annotated[float, *quantity("Hz", above=0)]
BandFrequency = Annotated[float, *quantity("Hz", above=0, at_most="10 THz")]
NoisePsd = Annotated[float, *quantity("mK2 / Hz", at_least=0)]
Temperature = Annotated[float, *quantity("mK")]
Load = Annotated[float, *quantity("K", at_least=0)]
Nep = Annotated[float, *quantity("W / Hz(1/2)", at_least=0)]
Memory = Annotated[float, *quantity("byte", above=0)]
Taper = Annotated[float, *quantity("dB", at_least=0)]
BandPowerExtent = Annotated[float, *quantity("uK2", at_least=0)]
PositiveBandPower = Annotated[float, *quantity("uK2", above=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Index = Annotated[
    float,
    BeforeValidator(_fraction),
    Field(gt=0, allow_inf_nan=False),
    of_file(["number", "string"], exclusiveMinimum=0, examples=["11/3"]),
]
Variances = Annotated[
    tuple[float, ...], BeforeValidator(lambda value: to_floats(value, "mK2")), _several("mK2", "[1, 2, 5] mK2")
]
Waters = Annotated[
    tuple[float, ...], BeforeValidator(lambda value: to_floats(value, "mm")), _several("mm", "[0.5, 1, 2] mm")
]
# Amplitudes of a power spectrum, whose unit goes with the screen's index: `Atmosphere` makes floats of them.
B2s = Annotated[tuple[float, ...], _several("mK2 rad(2 - index)", "[100, 280, 980] mK2 rad(-5/3)")]
Fluctuations = Annotated[tuple[float, ...], _several("rad(2 - index)", "[3e-6, 9e-6, 2e-5] rad(-5/3)")]
BandPowers = Annotated[
    tuple[tuple[str, PositiveBandPower], ...],
    BeforeValidator(_pairs),
    of_file("object", unit="uK2", exclusiveMinimum=0),
]
Ratios = Annotated[tuple[tuple[str, Positive], ...], BeforeValidator(_pairs), of_file("object", exclusiveMinimum=0)]
Coherence = Literal["field", "intensity", "none"]
Steps = Annotated[tuple[str, ...], BeforeValidator(_steps), Field(json_schema_extra=_steps_of_file)]
