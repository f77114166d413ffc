"""Weather of one observation: water vapour, B2 and wind drawn from the survey's distributions."""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, NamedTuple, Protocol

import numpy as np

from surveysim.atmosphere.dated_weather import DatedWeather
from surveysim.atmosphere.opacity import BandOpacity, slant_factor
from surveysim.atmosphere.water import Season, driest_mm, pwv_quantile, wettest_mm
from surveysim.runtime.errors import InputError, OutOfRangeError, SceneError
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.fields import B2_MAX
from surveysim.scene.passband import Passband
from surveysim.scene.place import Place
from surveysim.scene.sites import OWN

WIND_MAX_RAD_S = 1e3
LARGEST_LOG = 700.0  # its exponential is finite
_SEASON_RANKS = 100  # the same in each season of a survey
_RANKS = 400  # quantiles of water and of fluctuations, from which those of their product follow


@dataclass(frozen=True)
class Weather:
    """Weather of one observation.

    Attributes
    ----------
    b2
        Amplitude at the zenith [mK^2 rad^(2-b)].
    wind_speed_rad_s, wind_angle_rad
        Angular velocity of the layer in azimuth-elevation axes.
    pwv_mm
        Zenith column of precipitable water vapour; NaN without a site.
    """

    b2: float
    wind_speed_rad_s: float
    wind_angle_rad: float
    pwv_mm: float

    @property
    def wind_rad_s(self) -> tuple[float, float]:
        """Angular velocity of the layer along azimuth (on the sky) and elevation [rad/s]."""
        return (
            self.wind_speed_rad_s * math.cos(self.wind_angle_rad),
            self.wind_speed_rad_s * math.sin(self.wind_angle_rad),
        )


@dataclass(frozen=True, eq=False)  # an equal site gives the same record, by which draws are looked up
class Water:
    """Response of a band to the water vapour of a site.

    Attributes
    ----------
    opacity
    response
        (C d tau / dC)^2 B_atm^2 [mK^2] as a function of PWV [mm] (paper, section 3.3).
    log_b2, level : (n,)
        Quantiles of ln B2 that follow from the distributions of water and fluctuations, and their standard normal
        levels.
    """

    opacity: BandOpacity
    response: Callable[[float | np.ndarray], np.ndarray]
    log_b2: np.ndarray
    level: np.ndarray


class Draws(Protocol):
    """Random numbers of a generator that a draw of weather takes."""

    def standard_normal(self, size: int, /) -> np.ndarray:
        """Numbers (size,) of the standard normal distribution."""
        ...

    def uniform(self, low: float, high: float, /) -> float:
        """A number between two others."""
        ...

    def random(self) -> float:
        """A number between 0 and 1."""
        ...


class _Scores(NamedTuple):
    """Draws of an observation: standard normal levels of B2 (or water fluctuation) and wind speed, a wind direction
    [rad], and a probability of the water.
    """

    level: float
    speed: float
    angle: float
    share: float


@lru_cache(maxsize=8)
def site_water(atmosphere: Atmosphere, place: Place, band: Passband) -> Water:
    """Response of a band to the water vapour of a scene's site.

    Raises
    ------
    ValueError
        Where the opacity table does not cover the place, the band or the water, or is none, with the key of the scene.
    """
    from scipy.special import ndtri

    from surveysim.atmosphere.opacity import band_opacity, fluctuation_factor_mk2

    key = "site" if place.name == OWN else "atmosphere.site"
    try:
        opacity = band_opacity(place, band)
    except OutOfRangeError as error:
        raise SceneError(f"{key}: {error}") from None
    except InputError as error:
        raise SceneError(f"{key}.opacity: {error}") from None
    response = partial(fluctuation_factor_mk2, opacity)
    try:
        response(np.array([driest_mm(atmosphere), wettest_mm(atmosphere)]))
    except OutOfRangeError as error:
        raise SceneError(f"atmosphere.{'pwv_by_month' if atmosphere.pwv_by_month else 'pwv'}: {error}") from None
    share = (np.arange(_RANKS) + 0.5) / _RANKS
    seen = np.log(response(pwv_quantile(atmosphere, share)))
    drawn = np.log(log_quantile(atmosphere.water_fluctuation_probabilities, atmosphere.water_fluctuation, ndtri(share)))
    log_b2 = np.sort((seen[:, None] + drawn).ravel())
    if not atmosphere.b2 and not log_b2[-1] < math.log(B2_MAX):
        raise SceneError(
            f"atmosphere.water_fluctuation: found {atmosphere.water_fluctuation}, which give B2 above"
            f" {B2_MAX:g} mK^2 with the site's water; smaller values are expected"
        )
    rank = (np.arange(log_b2.size) + 0.5) / log_b2.size
    return Water(opacity, response, log_b2, ndtri(rank))


@lru_cache(maxsize=10_000)  # checks, forecasts and points of a sweep have weather in common
def survey_weather(
    atmosphere: Atmosphere, water: Water | None, seed: int, observation: int, *, dated: DatedWeather | None
) -> Weather:
    """Draw the weather of one observation of a survey; raises as `draw_weather`."""
    if dated is None or dated.scores is None:
        rng = generator(seed, RandomPurpose.WEATHER, observation)
        return draw_weather(atmosphere, water, rng, *(dated.of(observation) if dated else ()))
    level, speed, share, angle = dated.scores[observation].tolist()
    return _drawn(atmosphere, water, _Scores(level, speed, angle, share), *dated.of(observation))


def draw_weather(
    atmosphere: Atmosphere,
    water: Water | None,
    rng: Draws,
    when: Season | None = None,
    known: Mapping[str, float] | None = None,
) -> Weather:
    """Draw the weather of one observation.

    Wind speeds are log-normal about their median, directions uniform. Without a site, B2 is drawn from its quantiles.
    With a site it is (delta C / C)^2 (C d tau / dC)^2 B_atm^2, with PWV and fractional fluctuation drawn independently
    (paper, section 3.3); if the scene has quantiles of B2 too, they replace the resulting distribution, and each draw
    keeps its rank. Water by month is that of the season `when`, or of the whole year. With `wind_b2_exponent` the
    median wind scales with that power of B2 over its median. Values that are `known`, by the columns of
    `DatedWeather.known`, replace draws.

    Raises
    ------
    ValueError
        For a draw too large for a stream: extrapolated tails of closely spaced quantiles have no bound.
    """
    level, speed = rng.standard_normal(2)
    angle = rng.uniform(0, 2 * math.pi)
    return _drawn(atmosphere, water, _Scores(level, speed, angle, rng.random()), when, known or {})


def _drawn(
    atmosphere: Atmosphere, water: Water | None, scores: _Scores, when: Season | None, known: Mapping[str, float]
) -> Weather:
    pwv = math.nan if water is None else known.get("pwv", float(pwv_quantile(atmosphere, scores.share, when)))
    angle = known.get("wind_direction", scores.angle)
    return _weather(atmosphere, water, level=scores.level, speed=scores.speed, angle=angle, pwv_mm=pwv, known=known)


def survey_pwv_quantile(
    atmosphere: Atmosphere, dated: DatedWeather | None, probability: float | np.ndarray
) -> np.ndarray:
    """PWV [mm] below which the given probability lies: of the observations where it is known, else `pwv_quantile`."""
    if dated is not None and "pwv" in dated.known:
        return np.quantile(dated.known["pwv"], probability)
    return pwv_quantile(atmosphere, probability)


def fastest_wind(
    atmosphere: Atmosphere, water: Water | None, n_observations: int, *, dated: DatedWeather | None = None
) -> float:
    """Wind speed that no observation of a survey exceeds, with a probability of all but 1e-6 [rad/s].

    It is infinite for a negative power of a B2 that may be 0.

    Raises
    ------
    ValueError
        As `draw_weather`.
    """
    if dated is not None and "wind_speed" in dated.known:
        return float(dated.known["wind_speed"].max())
    if atmosphere.wind_b2_exponent < 0 and water is None and min(atmosphere.b2) == 0:
        return math.inf
    from scipy.special import ndtri

    beyond = -float(ndtri(1e-6 / (2 * n_observations)))
    extremes = [
        _weather(atmosphere, water, level=level, speed=beyond, angle=0.0, pwv_mm=pwv_mm, known={})
        for level in (-beyond, beyond)
        for pwv_mm in ((driest_mm(atmosphere), wettest_mm(atmosphere)) if water else (math.nan,))
    ]
    return max(weather.wind_speed_rad_s for weather in extremes)


def _b2(
    atmosphere: Atmosphere, water: Water | None, *, level: float, pwv_mm: float, known: Mapping[str, float]
) -> float:
    """B2 at a standard normal level of B2 (or fluctuation) and a column of water, or from a known value."""
    if "b2" in known:
        return known["b2"]
    if water is not None:
        fluctuation = known.get("water_fluctuation") or log_quantile(
            atmosphere.water_fluctuation_probabilities, atmosphere.water_fluctuation, level
        )
        log_b2 = math.log(water.response(pwv_mm)) + math.log(fluctuation)
        if "water_fluctuation" in known or ("pwv" in known and not atmosphere.b2):
            return math.exp(min(log_b2, LARGEST_LOG))  # beyond the scene's distributions, too
        level = np.interp(log_b2, water.log_b2, water.level)
    return float(b2_quantile(atmosphere, water, level))


def _weather(
    atmosphere: Atmosphere,
    water: Water | None,
    *,
    level: float,
    speed: float,
    angle: float,
    pwv_mm: float,
    known: Mapping[str, float],
) -> Weather:
    """Weather at standard normal levels of B2 (or fluctuation) and wind speed, a wind angle and a column of water."""
    b2 = _b2(atmosphere, water, level=level, pwv_mm=pwv_mm, known=known)
    wind = atmosphere.wind_median_rad_s * math.exp(atmosphere.wind_log_scatter * speed)
    if "wind_speed" in known:
        wind = known["wind_speed"]
    elif atmosphere.wind_b2_exponent and b2 > 0:
        if not (median := float(b2_quantile(atmosphere, water, 0.0))) > 0:
            raise SceneError("atmosphere.wind_b2_exponent: found with a median B2 of 0; one above 0 is expected")
        wind *= math.exp(min(atmosphere.wind_b2_exponent * (math.log(b2) - math.log(median)), LARGEST_LOG))
    # The margin is rounding of a quantile at the bound.
    if not (b2 < B2_MAX * (1 + 1e-9) and wind < WIND_MAX_RAD_S):
        key = "b2" if atmosphere.b2 else "water_fluctuation"
        raise SceneError(
            f"atmosphere.{key}: found distributions that give B2 = {b2:.3g} mK^2 and {wind:.3g} rad/s of wind; less"
            f" than {B2_MAX:g} and {WIND_MAX_RAD_S:g} are expected"
        )
    return Weather(b2, wind, angle, pwv_mm)


def b2_quantile(atmosphere: Atmosphere, water: Water | None, normal_level: float | np.ndarray) -> np.ndarray:
    """B2 at standard normal levels, from the scene's quantiles or else from those of its site."""
    if atmosphere.b2:
        return log_quantile(atmosphere.b2_probabilities, atmosphere.b2, normal_level)
    return np.exp(np.minimum(np.interp(normal_level, water.level, water.log_b2), LARGEST_LOG))


def slant_b2(
    water: Water | None, weather: Sequence[Weather], elevation_rad: Sequence[float] | np.ndarray
) -> np.ndarray:
    """B2 (n,) of the layer in observations at some mean elevations (n,), before the geometric sin(el)^(1 - b).

    With a site it is the B2 at the zenith times `slant_factor`; without one it does not depend on the elevation.
    """
    b2 = np.array([item.b2 for item in weather])
    if water is None:
        return b2
    pwv_mm, airmass = [item.pwv_mm for item in weather], [1 / math.sin(height) for height in elevation_rad]
    return b2 * slant_factor(water.opacity, np.array(pwv_mm), airmass=np.array(airmass))


def season_quantiles(
    atmosphere: Atmosphere, water: Water, when: tuple[Season, ...], probability: tuple[float, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Quantiles (n,) of B2 and of PWV [mm] of a survey whose water goes by month, at some probabilities."""
    from scipy.special import ndtri

    counts = Counter(when)
    share = (np.arange(_SEASON_RANKS) + 0.5) / _SEASON_RANKS
    pwv = np.array([pwv_quantile(atmosphere, share, item) for item in counts])
    fluctuation = log_quantile(atmosphere.water_fluctuation_probabilities, atmosphere.water_fluctuation, ndtri(share))
    product = np.log(water.response(pwv))[..., None] + np.log(fluctuation)
    b2 = b2_quantile(atmosphere, water, np.interp(product, water.log_b2, water.level))
    weights = np.array(list(counts.values()))
    return _weighted_quantiles(b2, weights, probability), _weighted_quantiles(pwv, weights, probability)


def _weighted_quantiles(rows: np.ndarray, weights: np.ndarray, probability: tuple[float, ...]) -> np.ndarray:
    """Quantiles of rows of values that count by a weight for each row."""
    values = rows.reshape(len(rows), -1)
    order = np.argsort(values, axis=None)
    total = np.cumsum(np.repeat(weights, values.shape[1])[order])
    return values.ravel()[order][np.searchsorted(total, np.array(probability) * total[-1])]


@lru_cache(maxsize=32)
def _knots(probabilities: tuple[float, ...], values: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray, float]:
    """Standard normal levels of quantiles, their logarithms, and the slope between the outermost two."""
    from scipy.special import ndtri

    levels, logs = ndtri(probabilities), np.log(values)
    levels.setflags(write=False)
    logs.setflags(write=False)
    return levels, logs, (logs[-1] - logs[0]) / (levels[-1] - levels[0])


def log_quantile(
    probabilities: tuple[float, ...], values: tuple[float, ...], normal_level: float | np.ndarray
) -> np.ndarray:
    """Value at standard normal levels, from quantiles at some probabilities.

    The logarithm is linear in the normal level between the quantiles. Beyond them it has the slope between the
    outermost two, a log-normal tail.
    """
    if len(values) == 1 or min(values) == 0:
        from scipy.special import ndtri

        between: Any = np.interp(normal_level, ndtri(probabilities), values)
        return between
    levels, logs, slope = _knots(probabilities, values)
    beyond = np.minimum(normal_level - levels[0], 0) + np.maximum(normal_level - levels[-1], 0)
    # Draws beyond `B2_MAX` are refused later, and must be finite here.
    return np.exp(np.clip(np.interp(normal_level, levels, logs) + slope * beyond, -LARGEST_LOG, LARGEST_LOG))
