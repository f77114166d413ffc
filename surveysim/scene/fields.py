"""Types of the values in a scene file: quantities, angles, dates, names, with their bounds.

Each type converts the value of the file to a float in internal units, or to a checked name. It raises ValueError with
the value found and the values expected.
"""

import math
import os
import re
from datetime import date
from fractions import Fraction
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, WithJsonSchema

from surveysim.scene.similar_names import did_you_mean
from surveysim.scene.sites import OWN, site_names
from surveysim.scene.table_path import TablePath
from surveysim.scene.units import NUMBER, shown, to_float, to_floats, to_sky_angle

FIRST_DATE, LAST_DATE = "1900-01-01", "2199-12-31"  # range of dates with accurate precession and nutation
LONGEST_LINE = 300
FLUCTUATION_MIN, FLUCTUATION_MAX = 1e-30, 1e24  # rad^(2 - index)
B2_MIN, B2_MAX = 1e-24, 1e24  # mK^2 rad^(2 - index): beyond any atmosphere, and in the range of float32 streams
_FRACTION = re.compile(rf"\s*(?:{NUMBER}|[+-]?\d{{1,9}}/\d{{1,9}})\s*", re.ASCII)
FILE = "path"  # format, in the JSON schema, of keys whose value can be the name of a file
PSD_MAX_MK2_HZ = 1e12  # bound of any white noise, one-sided, Rayleigh-Jeans


def of_file(kind: str | list[str], **facts: object) -> WithJsonSchema:
    """Describe a value of the file in the JSON schema: type, unit, bounds or choices.

    Three keywords extend JSON Schema: `unit`, and the bounds `at_least` and `at_most`, which are quantities.
    """
    return WithJsonSchema({"type": kind} | {key: fact for key, fact in facts.items() if fact is not None})


def _several(unit: str, example: str, most: float) -> WithJsonSchema:
    return of_file(["string", "array"], unit=unit, examples=[example], minimum=0, maximum=most)


def number(least: float, most: float | None = None, *, below: float | None = None) -> tuple[Any, BeforeValidator]:
    """Accept a number from `least` to `most`, or less than `below`; the result is unpacked into an `Annotated` type."""
    return Field(ge=least, le=most, lt=below, allow_inf_nan=False), BeforeValidator(_plain)


def whole(least: int, most: int) -> tuple[Any, BeforeValidator]:
    """Accept an integer from `least` to `most`; as `number`."""
    return Field(ge=least, le=most), BeforeValidator(_whole)


def quantity(
    unit: str,
    usual: str = "",
    *,
    above: float | None = None,
    at_least: float | str | None = None,
    at_most: str | None = None,
    zero_or: str | None = None,
) -> tuple[BeforeValidator, WithJsonSchema]:
    """Accept a quantity and convert it to a unit; the result is unpacked into an `Annotated` type.

    Parameters
    ----------
    unit
        Unit of the result.
    usual
        Unit that messages suggest; by default `unit`.
    above, at_least, at_most
        Bounds, in `unit` or as quantities such as "30 deg".
    zero_or
        Smallest value other than 0.
    """
    least = to_float(at_least, unit) if isinstance(at_least, str) else at_least
    most = None if at_most is None else to_float(at_most, unit)

    def check(value: object) -> float | None:
        if value is None:
            return None
        number = to_float(value, unit, usual)
        if above is not None and not number > above:
            raise ValueError(f"found {shown(value)}; a value above {above:g} is expected")
        if least is not None and not number >= least - 1e-12 * abs(least):
            shown_least = at_least if isinstance(at_least, str) else f"a value of {at_least:g}"
            raise ValueError(f"found {shown(value)}; {shown_least} or more is expected")
        if most is not None and not number <= most * (1 + 1e-12):
            raise ValueError(f"found {shown(value)}; {at_most} or less is expected")
        if zero_or is not None and 0 < number < to_float(zero_or, unit) * (1 - 1e-12):
            raise ValueError(f"found {shown(value)}; 0, or {zero_or} or more, is expected")
        return number

    lower = "at_least" if isinstance(at_least, str) else "minimum"
    bounds = {"exclusiveMinimum": above, lower: at_least, "at_most": at_most}
    return BeforeValidator(check), of_file("string", unit=unit, **bounds)


def quantities(unit: str, example: str, *, zero_or: str, at_most: str) -> tuple[BeforeValidator, WithJsonSchema]:
    """Accept a list of quantities, each 0 or from `zero_or` to `at_most`; as `quantity`."""
    least, most = to_float(zero_or, unit), to_float(at_most, unit)

    def check(value: object) -> tuple[float, ...]:
        numbers = to_floats(value, unit)
        if any(not number <= most * (1 + 1e-12) for number in numbers):
            raise ValueError(f"found {shown(value)}; {at_most} or less is expected of each")
        if any(0 < number < least * (1 - 1e-12) for number in numbers):
            raise ValueError(f"found {shown(value)}; 0, or {zero_or} or more, is expected of each")
        return numbers

    facts = {"unit": unit, "examples": [example], "minimum": 0, "at_most": at_most}
    return BeforeValidator(check), of_file(["string", "array"], **facts)


def _plain(value: object) -> object:
    """Refuse anything but a number, text and dates included."""
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
        raise ValueError(f"found {shown(value)}; a number is expected")
    return value


def _whole(value: object) -> object:
    if value is not None and (isinstance(value, bool) or not isinstance(value, int | float) or value % 1 != 0):
        raise ValueError(f"found {shown(value)}; an integer is expected")
    return None if value is None else int(value)


def _fraction(value: object) -> object:
    if not isinstance(value, str):
        return _plain(value)
    try:
        if not _FRACTION.fullmatch(value):
            raise ValueError
        return float(Fraction(value))
    except (ValueError, ZeroDivisionError, OverflowError):
        raise ValueError(f"found {shown(value)}; a number or a fraction like '11/3' is expected") from None


def _latitude(value: object) -> float:
    angle = to_sky_angle(value)
    if abs(angle) > math.pi / 2:
        raise ValueError(f"found {shown(value)}; -90 deg to 90 deg is expected")
    return angle


def _longitude(value: object) -> float:
    angle = to_sky_angle(value)
    if abs(angle) > 2 * math.pi:
        raise ValueError(f"found {shown(value)}; -360 deg to 360 deg is expected")
    return angle


def _date(value: Any) -> str:
    try:
        found = date.fromisoformat(value)
    except (TypeError, ValueError):
        raise ValueError(f"found {shown(value)}; a date in quotes like '2003-10-28' is expected") from None
    if not date.fromisoformat(FIRST_DATE) <= found <= date.fromisoformat(LAST_DATE):
        raise ValueError(f"found {shown(value)}; a date from {FIRST_DATE} to {LAST_DATE} is expected")
    return found.isoformat()


def _line(value: object) -> object:
    if isinstance(value, str) and not value.isprintable():
        raise ValueError(f"found {shown(value)}; one line of text without control characters is expected")
    if isinstance(value, str) and len(value) > LONGEST_LINE:
        raise ValueError(f"found {len(value)} characters, {shown(value)}; {LONGEST_LINE} or fewer are expected")
    return value


def _nside(value: object) -> object:
    # healpy ends the whole process for another one.
    if value is not None and value not in [2**k for k in range(14)]:
        raise ValueError(f"found {shown(value)}; a power of two from 1 to 8192 is expected")
    return value


def file_path(value: object, info: ValidationInfo) -> object:
    """Resolve the name of a file relative to the folder of the scene, which the context of the validation holds."""
    if value is None or isinstance(value, Path):
        return value
    if not isinstance(value, str) or not value or "\0" in value:
        raise ValueError(f"found {shown(value)}; the name of a file with a table is expected")
    return Path(os.path.realpath(Path(info.context["folder"]) / value)) if info.context else Path(value)


def _with_state(value: object) -> object:
    """Add the state of its file to a path."""
    return TablePath(value) if isinstance(value, Path) else value


def table_or_name(value: object, info: ValidationInfo) -> object:
    """Resolve the name of a file as `file_path`; a text without a suffix is the name of a table that ships."""
    return value if isinstance(value, str) and value and not Path(value).suffix else file_path(value, info)


def _photon_coherence(value: object) -> object:
    if value == "intensity":
        raise ValueError("found 'intensity'; photon noise with this correlation is 'hbt' now")
    return value


def _share_or_table(value: object, info: ValidationInfo) -> object:
    if isinstance(value, str | Path):
        return file_path(value, info)
    if value is not None and not (isinstance(value, int | float) and 0 <= value <= 1):
        raise ValueError(f"found {shown(value)}; a number from 0 to 1, or the name of a file with a table, is expected")
    return value


def _steps(value: object) -> object:
    from mapmaker.cleaning import ALGORITHMS

    steps = value if isinstance(value, list | tuple) else [value]
    for name in steps or [value]:
        if not isinstance(name, str) or name not in ALGORITHMS:
            raise ValueError(f"found {shown(name)}; one of {', '.join(map(repr, ALGORITHMS))} is expected")
    return tuple(steps)


def _steps_of_file(schema: dict[str, object]) -> None:
    """List the cleaning algorithms in the schema; a single one needs no list."""
    from mapmaker.cleaning import ALGORITHMS

    schema |= {"type": ["string", "array"], "items": {"enum": list(ALGORITHMS)}}


def _site(value: object) -> object:
    if value is not None and value not in (*site_names(), OWN):
        similar = did_you_mean(value, site_names()) if isinstance(value, str) else ""
        expected = similar or f"one of {', '.join(map(repr, site_names()))}, or a section [site], is expected"
        raise ValueError(f"found {shown(value)}; {expected}")
    return value


def _pairs(value: object) -> object:
    """Convert a table to pairs."""
    for name in value if isinstance(value, dict) else ():
        if not name.isprintable() or len(name) > LONGEST_LINE:
            raise ValueError(f"found the name {shown(name)}; one line without control characters is expected")
    return tuple(value.items()) if isinstance(value, dict) else value  # a scene is hashable, a dict is not


# Bounds lie beyond any use, and keep all that follows well within streams of 32 bits (1e38 mK).
Angle = Annotated[float, *quantity("rad", "deg", at_least="-360 deg", at_most="360 deg")]
PositiveAngle = Annotated[float, *quantity("rad", "arcsec", at_least="0.001 arcsec", at_most="180 deg")]
AngleExtent = Annotated[float, *quantity("rad", "arcmin", at_least=0, at_most="360 deg")]
BeamWidth = Annotated[float, *quantity("rad", "arcsec", at_least="0.001 arcsec", at_most="30 deg")]
# Airmass is 1 / sin(elevation): 11.5 at 5 degrees, where the curved atmosphere's is 10 % less.
Elevation = Annotated[float, *quantity("rad", "deg", at_least="5 deg", at_most="90 deg")]
HourAngle = Annotated[float, *quantity("rad", "hourangle", at_least="1 arcsec", at_most="180 deg")]
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
IsoDate = Annotated[
    str, BeforeValidator(_date), of_file("string", format="date", at_least=FIRST_DATE, at_most=LAST_DATE)
]
Line = Annotated[str, BeforeValidator(_line)]
Nside = Annotated[int | None, BeforeValidator(_nside), of_file("integer", enum=[2**k for k in range(14)])]
SiteName = Annotated[str | None, BeforeValidator(_site), of_file("string", enum=site_names())]
TableFile = Annotated[
    Path | None,
    BeforeValidator(file_path),
    AfterValidator(_with_state),
    of_file("string", format=FILE, examples=["camera.ecsv"]),
]
TableOrName = Annotated[
    Path | str | None, BeforeValidator(table_or_name), AfterValidator(_with_state), of_file("string", format=FILE)
]
ShareOrTable = Annotated[
    Path | float | None,
    BeforeValidator(_share_or_table),
    AfterValidator(_with_state),
    of_file(["number", "string"], format=FILE, minimum=0, maximum=1),
]
Speed = Annotated[float, *quantity("rad / s", "arcmin / s", at_least="0.001 arcsec / s", at_most="360 deg / s")]
SpeedExtent = Annotated[float, *quantity("rad / s", "arcmin / s", at_least=0, at_most="360 deg / s")]
Acceleration = Annotated[float, *quantity("rad / s2", "deg / s2", at_least="0.001 arcsec / s2", at_most="360 deg / s2")]
Jerk = Annotated[float, *quantity("rad / s3", "deg / s3", at_least="0.001 arcsec / s3", at_most="3600 deg / s3")]
Duration = Annotated[float, *quantity("s", at_least="1 us", at_most="10 day")]
DurationExtent = Annotated[float, *quantity("s", at_least=0, at_most="10 day")]
Height = Annotated[float, *quantity("m", at_least="-1 km", at_most="100 km")]
Length = Annotated[float, *quantity("m", at_least="1 mm", at_most="100000 km")]
Diameter = Annotated[float, *quantity("m", at_least=0, at_most="100000 km")]
Frequency = Annotated[float, *quantity("Hz", at_least="1e-6 Hz", at_most="1 GHz")]
BandFrequency = Annotated[float, *quantity("Hz", "GHz", at_least="1 GHz", at_most="10 THz")]
NoisePsd = Annotated[
    float, *quantity("mK2 / Hz", at_least=0, at_most=f"{PSD_MAX_MK2_HZ:g} mK2 / Hz", zero_or="1e-12 mK2 / Hz")
]
Temperature = Annotated[float, *quantity("mK", at_least="-1e6 K", at_most="1e6 K")]
Flux = Annotated[float, *quantity("Jy", "mJy", at_least="-1e9 Jy", at_most="1e9 Jy")]
Load = Annotated[float, *quantity("K", at_least=0, at_most="10000 K", zero_or="1e-9 K")]
PhysicalTemperature = Annotated[float, *quantity("K", at_least="0.001 K", at_most="10000 K")]
Conductance = Annotated[float, *quantity("W / K", "pW / K", at_least="1e-18 W / K", at_most="1 W / K")]
Energy = Annotated[float, *quantity("J", "meV", at_least="1e-26 J", at_most="1e-19 J")]
Nep = Annotated[float, *quantity("W / Hz(1/2)", at_least=0, at_most="1e-6 W / Hz(1/2)", zero_or="1e-30 W / Hz(1/2)")]
Memory = Annotated[float, *quantity("byte", "MB", at_least="1 byte", at_most="1e15 byte")]
Taper = Annotated[float, *quantity("dB", at_least=0, at_most="1000 dB")]
BandPowerExtent = Annotated[float, *quantity("uK2", at_least=0, at_most="1e15 uK2")]
PositiveBandPower = Annotated[float, *quantity("uK2", at_least="1e-6 uK2", at_most="1e15 uK2")]
Positive = Annotated[float, *number(1e-6, 1e6)]
AboveOne = Annotated[float, Field(gt=1, le=1e6, allow_inf_nan=False), BeforeValidator(_plain)]
Share = Annotated[float, *number(0, 1)]
Bandwidth = Annotated[float, *number(1e-6, below=1)]
Probabilities = tuple[Share, ...]
# Of excess noise, in the unit that its knots have whatever the index.
B2Knots = tuple[Annotated[float, BeforeValidator(_plain), of_file("number", minimum=0, maximum=B2_MAX)], ...]
Index = Annotated[
    float,
    BeforeValidator(_fraction),
    Field(ge=0.01, le=20, allow_inf_nan=False),
    of_file(["number", "string"], minimum=0.01, maximum=20, examples=["11/3"]),
]
Frequencies = Annotated[tuple[float, ...], *quantities("Hz", "[1.4, 2.8] Hz", zero_or="1e-6 Hz", at_most="1 GHz")]
Variances = Annotated[tuple[float, ...], *quantities("mK2", "[1, 2, 5] mK2", zero_or="1e-12 mK2", at_most="1e12 mK2")]
FrequencyEdges = Annotated[
    tuple[float, ...], *quantities("Hz", "[0.1, 0.4, 1.6] Hz", zero_or="1e-6 Hz", at_most="1 GHz")
]
Waters = Annotated[tuple[float, ...], *quantities("mm", "[0.5, 1, 2] mm", zero_or="1e-6 mm", at_most="1000 mm")]
# Amplitudes of a power spectrum, whose unit goes with the screen's index: `Atmosphere` makes floats of them.
B2s = Annotated[tuple[float, ...], _several("mK2 rad(2 - index)", "[100, 280, 980] mK2 rad(-5/3)", B2_MAX)]
Fluctuations = Annotated[tuple[float, ...], _several("rad(2 - index)", "[3e-6, 9e-6, 2e-5] rad(-5/3)", FLUCTUATION_MAX)]
BandPowers = Annotated[
    tuple[tuple[str, PositiveBandPower], ...],
    BeforeValidator(_pairs),
    of_file("object", unit="uK2", at_least="1e-6 uK2", at_most="1e15 uK2"),
]
Ratios = Annotated[
    tuple[tuple[str, Positive], ...], BeforeValidator(_pairs), of_file("object", minimum=1e-6, maximum=1e6)
]
Coherence = Literal["field", "intensity", "none"]
PhotonCoherence = Annotated[Literal["hbt", "field", "none"], BeforeValidator(_photon_coherence)]
Steps = Annotated[tuple[str, ...], BeforeValidator(_steps), Field(json_schema_extra=_steps_of_file)]
