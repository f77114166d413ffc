"""Numbers as text for people: rounded to their errors, in units that suit them."""

import math
from collections.abc import Sequence

MINUS, TIMES, NARROW = "\u2212", "\u00d7", "\u202f"
EXACT = 1e-9  # relative error below which a number has none but that of its rounding
_PLAIN = str.maketrans({MINUS: "-", TIMES: "x", NARROW: "", "±": "+-"})


def times(value: float | None, factor: float) -> float | None:
    """A number of a summary times a factor; None, as null is read, stays what it is."""
    return None if value is None else value * factor


def with_error(value: float, error: float | None, digits: int = 0) -> str:
    """``221.1 ± 5.2``: both rounded to two digits of the error; three digits without one, or where it is rounding's.

    A value has at least `digits`, even where its error is larger.
    """
    if error is None or not (math.isfinite(error) and error > EXACT * abs(value)):
        return number(value)
    size = max(abs(value), error)
    if 1e-3 <= size < 1e6:
        places = _places(error, 2)
        if digits and value:
            places = max(places, _places(value, digits))
        return f"{_fixed(value, places)} ± {_fixed(error, places)}"
    exponent = math.floor(math.log10(size))
    scale = 10.0**exponent
    return f"({with_error(value / scale, error / scale, digits)}) {TIMES} 10^({_signed(str(exponent))})"


def quoted(value: float | None, error: float | None, digits: int = 0) -> str:
    """As `with_error`, with "unknown" for an error of None or NaN and for a value of None."""
    if value is None:
        return "unknown"
    if error is None or not math.isfinite(error):
        return f"{number(value)} ± unknown"
    return with_error(value, error, digits)


def quoted_share(value: float | None, error: float | None) -> str:
    """A share in percent, as `quoted`."""
    return f"({quoted(times(value, 100), times(error, 100))}) %"


def as_known(value: float, error: float | None) -> str:
    """A number rounded to two digits of an error, or to three of its own where that is unknown."""
    if error is None or value is None or not math.isfinite(error):
        return number(value)
    return _fixed(value, _places(error, 2))


def number(value: float | None, digits: int = 3) -> str:
    """A number of so many digits, without exponent from 0.001 to a million; "none" for None."""
    if value is None:
        return "none"
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "none"
    rounded = float(f"{value:.{digits - 1}e}")
    if not 1e-3 <= abs(rounded) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{_signed(mantissa)} {TIMES} 10^({_signed(str(int(exponent)))})"
    return _fixed(value, digits - 1 - math.floor(math.log10(abs(rounded))))


def short(value: float) -> str:
    """A number as it was given, up to six digits, without trailing zeros."""
    if value != 0 and not 1e-3 <= abs(value) < 1e6:  # NaN too
        return number(value)
    return _signed(_grouped(f"{value:,.6g}", value))


def percent(share: float | None, error: float | None = None) -> str:
    """A share in percent, as `with_error` writes numbers; "unknown" for None."""
    if share is None:
        return "unknown"
    if error is not None and error > 0:
        return f"({with_error(100 * share, 100 * error)}) %"
    return f"{number(100 * share, 2)} %"


def count(value: float | None) -> str:
    """A number without decimals, its digits in threes from five on; "none" for None."""
    return "none" if value is None else _fixed(value, 0)


def day_and_time(date: str) -> str:
    """A moment as summary.json has it, for readers."""
    return date.replace("T", " ").replace("+00:00", " UTC")


def duration(seconds: float | None) -> str:
    """A time in the unit that suits it; "unknown" for None."""
    if seconds is None:
        return "unknown"
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{number(seconds / size, 2)} {unit}"
    return f"{number(seconds, 2)} s" if seconds >= 0.1 else f"{number(1e3 * seconds, 2)} ms"


def plural(n: int, thing: str) -> str:
    """A number with the noun in singular or plural."""
    return f"{count(n)} {thing}" if n == 1 else f"{count(n)} {thing}s"


def joined(items: Sequence[str]) -> str:
    """``a, b and c``."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else ""


def _places(value: float, digits: int) -> int:
    """Decimals that show so many digits of a number, of the rounded one: two of 0.0996 are 0.10."""
    return digits - 1 - int(f"{value:.{digits - 1}e}".partition("e")[2])


def _fixed(value: float, places: int) -> str:
    return _signed(_grouped(f"{round(value, places):,.{max(places, 0)}f}", value))


def _grouped(text: str, value: float) -> str:
    """A number with commas between thousands: apart from five digits on, without below."""
    return text.replace(",", NARROW if abs(value) >= 1e4 else "")


def _signed(text: str) -> str:
    return text.replace("-", MINUS)


def plain(text: str) -> str:
    """Write a number of this module in ASCII, as on a terminal."""
    return text.translate(_PLAIN)
