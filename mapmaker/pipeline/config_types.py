"""Types of the values in a configuration of `mapmaker clean-and-map`: quantities with units, numbers, sections."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

_LONGEST = 60  # characters of a wrong value in a message


class Section(BaseModel):
    """Base of all sections: frozen, without unknown keys; the docstring of a field is its description."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, strict=True)


@dataclass(frozen=True)
class Kind:
    """Name of a type for people, in the metadata of a field."""

    text: str


def shown(value: object) -> str:
    """Show a value in a message, shortened."""
    text = repr(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def quantity(unit: str, example: str, *, above: float = 0.0, most: float = math.inf) -> BeforeValidator:
    """Accept a text with a unit, and convert it to `unit`; bounds are in that unit."""

    def check(value: object) -> float:
        from astropy.units import Quantity

        found = _converted(value, unit, example, Quantity)
        if not above < found <= most:
            bounds = f"above {above:g}" + (f" and up to {most:g}" if math.isfinite(most) else "")
            raise ValueError(f"found {shown(value)}; a value {bounds} {unit} is expected")
        return found

    return BeforeValidator(check)


def direction(name: str, most_deg: float) -> BeforeValidator:
    """Accept a right ascension or a declination, such as "132.3 deg" or "8h49m12s", and convert it to rad."""

    def check(value: object) -> float:
        from astropy.coordinates import Angle

        example = "132.3 deg" if name == "right ascension" else "44.84 deg"
        found = _converted(value, "rad", example, Angle)
        if abs(found) > math.radians(most_deg) * (1 + 1e-12):
            raise ValueError(f"found {shown(value)}; a {name} up to {most_deg:g} deg is expected")
        return found

    return BeforeValidator(check)


def _converted(value: object, unit: str, example: str, parsed: Callable[[str], Any]) -> float:
    from astropy import units

    expected = f'a quantity with a unit, as "{example}", is expected'
    if not isinstance(value, str) or not value.isascii() or len(value) > _LONGEST:
        raise ValueError(f"found {shown(value)}; {expected}")
    try:
        found = float(parsed(value).to_value(unit))
    except (units.UnitsError, TypeError, ValueError, ArithmeticError):
        raise ValueError(f"found {shown(value)}; {expected}") from None
    if not math.isfinite(found):
        raise ValueError(f"found {shown(value)}; {expected}")
    return found


Length = Annotated[float, quantity("rad", "20 arcsec", most=math.pi), Kind('angle, as `"20 arcsec"`')]
Frequency = Annotated[float, quantity("Hz", "0.1 Hz"), Kind('frequency, as `"0.1 Hz"`')]
Duration = Annotated[float, quantity("s", "1 s"), Kind('time, as `"1 s"`')]
RightAscension = Annotated[float, direction("right ascension", 720.0), Kind('`"132.3 deg"` or `"8h49m12s"`')]
Declination = Annotated[float, direction("declination", 90.0), Kind('`"44.84 deg"` or `"44d50m"`')]


def _real(value: object) -> object:
    """Accept integers where a number is expected."""
    return float(value) if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**53 else value


def number(*, least: float | None = None, above: float | None = None, most: float | None = None) -> Any:
    """Type of a finite number within bounds."""
    return Annotated[float, BeforeValidator(_real), Field(ge=least, gt=above, le=most, allow_inf_nan=False)]


def whole(least: int, most: int) -> Any:
    """Type of an integer within bounds."""
    return Annotated[int, Field(ge=least, le=most)]
