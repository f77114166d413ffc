"""The weather that observations draw, against the quantiles it comes from."""

import math

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from surveysim.atmosphere.weather import b2_quantile, draw_weather
from surveysim.scene.atmosphere import Atmosphere

N_DRAWS = 16000
LYNX = {
    "spectral_index": "11/3",
    "layer_height": "1000 m",
    "illuminated_aperture": "8 m",
    "b2_probabilities": [0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875],
    "b2": "[46, 100, 170, 280, 580, 980, 4000] mK2 rad(-5/3)",
    "wind_median": "31 arcmin / s",
    "wind_log_scatter": 0.4,
}
ATMOSPHERE = Atmosphere.model_validate(LYNX)


@pytest.fixture(scope="module")
def draws():
    rng = np.random.default_rng(20031028)
    return [draw_weather(ATMOSPHERE, None, rng) for _ in range(N_DRAWS)]


def fraction_tolerance(p):
    """5 standard deviations of a fraction among N_DRAWS, binomial."""
    return 5 * math.sqrt(p * (1 - p) / N_DRAWS)


def median_tolerance(spread):
    """5 standard deviations of the median of N_DRAWS normals of standard deviation `spread`."""
    return 5 * spread * math.sqrt(math.pi / 2 / N_DRAWS)


def test_quantiles_are_those_of_the_scene():
    levels = ndtri(ATMOSPHERE.b2_probabilities)
    np.testing.assert_allclose(b2_quantile(ATMOSPHERE, None, levels), ATMOSPHERE.b2, rtol=1e-13)
    assert b2_quantile(ATMOSPHERE, None, 0.0) == pytest.approx(280, rel=1e-13)


def test_quantiles_increase_within_and_beyond_the_knots():
    b2 = b2_quantile(ATMOSPHERE, None, np.linspace(-4, 4, 2001))
    assert (np.diff(b2) > 0).all() and b2[0] > 0
    assert b2[0] < 46 < 4000 < b2[-1]


def test_between_knots_the_logarithm_is_linear():
    low, high = ndtri([0.5, 0.625])
    assert b2_quantile(ATMOSPHERE, None, 0.75 * low + 0.25 * high) == pytest.approx(280**0.75 * 580**0.25, rel=1e-13)


def test_tails_are_log_normal_with_the_slope_of_the_outermost_knots():
    low, high = ndtri([0.125, 0.875])
    slope = math.log(4000 / 46) / (high - low)
    assert b2_quantile(ATMOSPHERE, None, high + 1.5) == pytest.approx(4000 * math.exp(1.5 * slope), rel=1e-12)
    assert b2_quantile(ATMOSPHERE, None, low - 0.7) == pytest.approx(46 * math.exp(-0.7 * slope), rel=1e-12)


def test_one_weather_or_none():
    for b2, expected in (("[280] mK2 rad(-5/3)", 280), ("[0] mK2 rad(-5/3)", 0)):
        one = Atmosphere.model_validate(LYNX | {"b2_probabilities": [0.5], "b2": b2})
        np.testing.assert_allclose(b2_quantile(one, None, np.array([-3, 0, 3.0])), expected, rtol=1e-13)
    none = Atmosphere.model_validate(LYNX | {"b2_probabilities": [0.25, 0.75], "b2": "[0, 0] mK2 rad(-5/3)"})
    assert draw_weather(none, None, np.random.default_rng(1)).b2 == 0


@pytest.mark.parametrize("p, b2", [(0.25, 100), (0.5, 280), (0.75, 980), (0.125, 46), (0.875, 4000)])
def test_drawn_fractions_below_the_quantiles(draws, p, b2):
    below = np.mean([weather.b2 < b2 for weather in draws])
    assert below == pytest.approx(p, abs=fraction_tolerance(p))


def test_drawn_fraction_in_the_tail(draws):
    """Above 40000, ten times the last knot."""
    level = ndtri(0.875) * (1 + 2 * math.log(10) / math.log(4000 / 46))
    p = float(ndtr(-level))
    assert np.mean([weather.b2 > 40000 for weather in draws]) == pytest.approx(p, abs=fraction_tolerance(p))


def test_wind_speed_is_log_normal(draws):
    logs = np.log([weather.wind_speed_rad_s for weather in draws])
    assert np.median(logs) == pytest.approx(math.log(math.radians(31 / 60)), abs=median_tolerance(0.4))
    # The standard deviation of n normals is known to 1 / sqrt(2 n).
    assert logs.std() == pytest.approx(0.4, rel=5 / math.sqrt(2 * N_DRAWS))


def test_wind_direction_is_uniform(draws):
    """Mean vectors of the angle and of twice it vanish, to 1 / sqrt(2 n) a component; octants are equal."""
    angle = np.array([weather.wind_angle_rad for weather in draws])
    assert (angle >= 0).all() and (angle < 2 * math.pi).all()
    for order in (1, 2):
        for component in (np.cos, np.sin):
            assert abs(component(order * angle).mean()) < 5 / math.sqrt(2 * N_DRAWS)
    octants = np.histogram(angle, 8, (0, 2 * math.pi))[0] / N_DRAWS
    assert np.abs(octants - 1 / 8).max() < fraction_tolerance(1 / 8)


def test_b2_speed_and_direction_are_independent(draws):
    """Correlations of n independent pairs have the standard deviation 1 / sqrt(n)."""
    levels = np.array([[math.log(w.b2), math.log(w.wind_speed_rad_s), w.wind_angle_rad] for w in draws])
    correlation = np.corrcoef(levels.T) - np.eye(3)
    assert np.abs(correlation).max() < 5 / math.sqrt(N_DRAWS)


def test_wind_along_azimuth_and_elevation(draws):
    for weather in draws[:20]:
        along_azimuth, along_elevation = weather.wind_rad_s
        assert math.hypot(along_azimuth, along_elevation) == pytest.approx(weather.wind_speed_rad_s)
        assert math.remainder(math.atan2(along_elevation, along_azimuth) - weather.wind_angle_rad, 2 * math.pi) == (
            pytest.approx(0, abs=1e-12)
        )
