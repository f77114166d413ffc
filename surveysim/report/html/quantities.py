"""Angles, shares and lists of numbers in words; digits that conversions to radians and back leave are rounded off."""

import math

from surveysim.runtime.numbers import short


def arcmin(rad: float) -> str:
    """Write an angle in arcminutes."""
    return f"{short(_clean(math.degrees(rad) * 60))} arcmin"


def arcsec(rad: float) -> str:
    """Write an angle in arcseconds, with four digits."""
    return f"{short(float(f'{math.degrees(rad) * 3600:.4g}'))} arcsec"


def percent(share: float) -> str:
    """Write a share in percent."""
    return f"{short(_clean(100 * share))} %"


def deg(rad: float) -> str:
    """Write the number of degrees of an angle."""
    return short(_clean(math.degrees(rad)))


def _clean(value: float) -> float:
    """Remove the rounding errors of conversions to radians and back."""
    return float(f"{value:.6g}")


def hours(rad: float) -> str:
    """Write a right ascension in hours, minutes and seconds."""
    seconds = round(math.degrees(rad) / 15 * 3600, 1) % 86400
    return f"{int(seconds // 3600):02d}h {int(seconds // 60 % 60):02d}m {short(seconds % 60)}s"


def degrees(rad: float) -> str:
    """Write a declination in degrees, minutes and seconds."""
    seconds = round(abs(math.degrees(rad)) * 3600, 1)
    sign = "−" if rad < 0 else "+"
    return f"{sign}{int(seconds // 3600):02d}° {int(seconds // 60 % 60):02d}′ {short(seconds % 60)}″"


def listed(values: list[float]) -> str:
    """Write numbers with commas between them."""
    return ", ".join(short(value) for value in values)


def span(values: list[float]) -> str:
    """Write the first and the last number, or the one there is."""
    return short(values[0]) if len(values) == 1 else f"{short(values[0])} to {short(values[-1])}"
