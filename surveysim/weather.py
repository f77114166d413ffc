"""The weather of one observation: B2 and wind drawn from the survey's distributions."""

import math
from dataclasses import dataclass

import numpy as np

from surveysim.sections import Atmosphere


@dataclass(frozen=True)
class Weather:
    """One draw: B2 at zenith [mK^2 rad^(b-2) of the screen's index] and the wind in azimuth-elevation axes."""

    b2: float
    wind_speed_rad_s: float
    wind_angle_rad: float

    @property
    def wind_rad_s(self) -> tuple[float, float]:
        """Angular velocity of the layer along azimuth (on the sky) and elevation."""
        return (
            self.wind_speed_rad_s * math.cos(self.wind_angle_rad),
            self.wind_speed_rad_s * math.sin(self.wind_angle_rad),
        )


def draw_weather(atmosphere: Atmosphere, rng: np.random.Generator) -> Weather:
    """B2 from the quantiles of the scene; wind speed log-normal about its median, direction uniform."""
    level, speed = rng.standard_normal(2)
    angle = rng.uniform(0, 2 * math.pi)
    b2 = float(b2_quantile(atmosphere, level))
    return Weather(b2, atmosphere.wind_median_rad_s * math.exp(atmosphere.wind_log_scatter * speed), angle)


def b2_quantile(atmosphere: Atmosphere, normal_level: np.ndarray) -> np.ndarray:
    """B2 at a level of the standard normal distribution.

    ln B2 is linear in the normal level between the quantiles of the scene; beyond them it goes on
    with the slope between the outermost two, a log-normal tail.
    """
    from scipy.special import ndtri

    if len(atmosphere.b2) == 1 or min(atmosphere.b2) == 0:
        return np.interp(normal_level, ndtri(atmosphere.b2_probabilities), atmosphere.b2)
    levels, logs = ndtri(atmosphere.b2_probabilities), np.log(atmosphere.b2)
    slope = (logs[-1] - logs[0]) / (levels[-1] - levels[0])
    beyond = np.minimum(normal_level - levels[0], 0) + np.maximum(normal_level - levels[-1], 0)
    return np.exp(np.interp(normal_level, levels, logs) + slope * beyond)
