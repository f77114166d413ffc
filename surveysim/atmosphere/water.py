"""Distribution of the water vapour above a site: all year, or by month and hour."""

import math
from dataclasses import dataclass
from datetime import date
from functools import lru_cache

import numpy as np

from surveysim.scene.atmosphere import Atmosphere

MJD_ZERO_ORDINAL = date(1858, 11, 17).toordinal()
_RANKS = 400  # quantiles of each month, from which those of the year follow


@dataclass(frozen=True)
class Season:
    """Month (0 to 11) and hour (0 to 23) of an observation, in local mean solar time."""

    month: int
    hour: int


def seasons(start_mjd: np.ndarray, longitude_rad: float) -> tuple[Season, ...]:
    """Return the seasons of times (n,) (UTC) at a longitude, east positive."""
    east = math.remainder(longitude_rad, 2 * math.pi) / (2 * math.pi)
    days, parts = np.divmod(start_mjd + east, 1)
    months = [date.fromordinal(day + MJD_ZERO_ORDINAL).month - 1 for day in days.astype(int).tolist()]
    return tuple(map(Season, months, (24 * parts).astype(int).tolist()))


def pwv_quantile(atmosphere: Atmosphere, probability: float | np.ndarray, when: Season | None = None) -> np.ndarray:
    """PWV [mm] below which the given probability lies: ln PWV is linear in probability between the quantiles.

    Unlike B2 it has no tails, because opacity tables are finite: the outermost quantiles are the extremes. With water
    by month it is that of the season `when`, or else of all months and hours together.
    """
    if not atmosphere.pwv_by_month:
        return _between(atmosphere, atmosphere.pwv_mm, probability)
    if when is None:
        return np.quantile(_year_mm(atmosphere), probability)
    factor = atmosphere.pwv_by_hour[when.hour] if atmosphere.pwv_by_hour else 1.0
    return factor * _between(atmosphere, atmosphere.pwv_by_month[when.month], probability)


def wettest_mm(atmosphere: Atmosphere) -> float:
    """Largest PWV of any observation [mm]."""
    return max(map(max, atmosphere.pwv_by_month or (atmosphere.pwv_mm,))) * max(atmosphere.pwv_by_hour or (1.0,))


def driest_mm(atmosphere: Atmosphere) -> float:
    """Smallest PWV of any observation [mm]."""
    return min(map(min, atmosphere.pwv_by_month or (atmosphere.pwv_mm,))) * min(atmosphere.pwv_by_hour or (1.0,))


@lru_cache(maxsize=8)
def _year_mm(atmosphere: Atmosphere) -> np.ndarray:
    """Equally likely PWV (n,) [mm] in all months and hours, the extremes included."""
    share = np.linspace(0, 1, _RANKS)
    months = [_between(atmosphere, quantiles, share) for quantiles in atmosphere.pwv_by_month]
    return np.multiply.outer(atmosphere.pwv_by_hour or (1.0,), months).ravel()


def _between(atmosphere: Atmosphere, quantiles_mm: tuple[float, ...], probability: float | np.ndarray) -> np.ndarray:
    return np.exp(np.interp(probability, atmosphere.pwv_probabilities, np.log(quantiles_mm)))
