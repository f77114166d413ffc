"""Weather that depends on the dates of a survey's observations: seasons, tables, and drift from one to the next."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import accumulate

import numpy as np

from surveysim.atmosphere.water import Season
from surveysim.runtime.rng import RandomPurpose, generator

DAY_S = 86400.0
Known = tuple[tuple[str, tuple[float, ...]], ...]  # columns by name
APART = 3.0  # correlation times between observations whose weather counts as independent: they correlate by 5 %
LONGEST = 10.0  # correlation times in a block of observations: the error from such blocks is 5 % low


@dataclass(frozen=True, eq=False)  # equal surveys have the same record, by which draws are looked up
class DatedWeather:
    """Dependence of the weather on the dates of all observations of a survey.

    Attributes
    ----------
    seasons
        Season of each observation; None unless the water depends on it.
    known
        Values (n_obs,) of a table by the name of the column, in place of draws: water [mm], B2 or water fluctuation,
        wind speed [rad/s] and direction in azimuth-elevation axes [rad].
    scores : (n_obs, 4)
        Draws of each observation, as `drifting_scores`; None for independent ones.
    block : (n_obs,)
        Block of each observation, as `independent_blocks`; None where all are independent.
    variance_factor
        Bound of `variance_factor`.
    """

    seasons: tuple[Season, ...] | None = None
    known: Mapping[str, np.ndarray] = field(default_factory=dict)
    scores: np.ndarray | None = None
    block: np.ndarray | None = None
    variance_factor: float = 1.0

    def of(self, observation: int) -> tuple[Season | None, dict[str, float]]:
        """Season of an observation, None unless the water depends on it, and known values by column."""
        season = None if self.seasons is None else self.seasons[observation]
        return season, {name: float(values[observation]) for name, values in self.known.items()}

    def sampling_factor(self, *, with_water: bool) -> float:
        """Bound of the variance of a mean over observations, over that of independent draws; 0 if nothing is drawn."""
        drawn = {"wind_speed", "wind_direction", *(("pwv",) if with_water else ())} - self.known.keys()
        return self.variance_factor if drawn or not {"b2", "water_fluctuation"} & self.known.keys() else 0.0


@lru_cache(maxsize=8)  # points of a sweep have weather in common
def dated_weather(
    seed: int,
    start_mjd: tuple[float, ...],
    *,
    correlation_s: float | None = None,
    seasons: tuple[Season, ...] | None = None,
    known: Known | None = None,
) -> DatedWeather:
    """Return the weather of observations at some times (n_obs,) [MJD], with what is known of each."""
    values = {name: np.array(column) for name, column in known or ()}
    if correlation_s is None:
        return DatedWeather(seasons, values)
    start_s = np.array(start_mjd) * DAY_S
    return DatedWeather(
        seasons,
        values,
        drifting_scores(seed, start_s, correlation_s),
        independent_blocks(start_s, correlation_s),
        variance_factor(start_s, correlation_s),
    )


def drifting_scores(seed: int, start_s: np.ndarray, correlation_s: float) -> np.ndarray:
    """Draw the numbers (n_obs, 4) that give the weather of observations, correlated by exp(-lag / correlation time).

    They are standard normal levels of B2 (or water fluctuation) and wind speed, the probability of the water, and the
    wind direction [rad]. The normal levels, also of the water, are Gauss-Markov processes. The direction is Brownian
    motion on the circle: it is uniform, and the mean cosine of its change is exp(-lag / correlation time). Row i
    depends on the starts (n_obs,) [s] of observations 0 to i alone.
    """
    from scipy.special import ndtr

    white = generator(seed, RandomPurpose.WEATHER_DRIFT).standard_normal((len(start_s), 4))
    lag = np.diff(start_s) / correlation_s
    kept, fresh = np.exp(-lag), np.sqrt(-np.expm1(-2 * lag))
    level, speed, water = (_gauss_markov(column, kept, fresh) for column in white.T[:3])
    turns = np.append(2 * np.pi * ndtr(white[:1, 3]), np.sqrt(2 * lag) * white[1:, 3])
    return np.column_stack([level, speed, ndtr(water), np.cumsum(turns) % (2 * np.pi)])


def _gauss_markov(white: np.ndarray, kept: np.ndarray, fresh: np.ndarray) -> np.ndarray:
    """Correlate deviates (n,): each keeps a part (n - 1,) of the one before it."""
    steps = zip(kept.tolist(), (fresh * white[1:]).tolist(), strict=True)
    return np.array(list(accumulate(steps, lambda last, step: step[0] * last + step[1], initial=float(white[0]))))


def independent_blocks(start_s: np.ndarray, correlation_s: float) -> np.ndarray:
    """Number (n_obs,) the consecutive blocks of observations whose weather is nearly independent, from 0.

    A block ends before a gap of `APART` correlation times, and where it would last more than `LONGEST`.
    """
    first, last = start_s[0], start_s[0]
    begins = np.zeros(len(start_s), int)
    for number, start in enumerate(start_s.tolist()):
        if start - last >= APART * correlation_s or start - first > LONGEST * correlation_s:
            first, begins[number] = start, 1
        last = start
    return np.cumsum(begins)


def variance_factor(start_s: np.ndarray, correlation_s: float) -> float:
    """Return the largest ratio of the variance of a mean over observations to that of independent ones.

    Functions of Gaussian deviates correlate no more than the deviates themselves (Gebelein 1941). A mean of n
    observations therefore has at most sum_ij exp(-|t_i - t_j| / correlation time) / n times the variance.
    """
    reach, total = 0.0, 0.0
    for kept in np.exp(-np.diff(start_s) / correlation_s).tolist():
        reach = kept * (reach + 1)
        total += reach
    return 1 + 2 * total / len(start_s)
