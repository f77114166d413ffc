"""Water by month and hour: each observation draws from the distribution of its date."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from surveysim.atmosphere.water import Season, driest_mm, pwv_quantile, seasons, wettest_mm
from surveysim.atmosphere.weather import draw_weather, season_quantiles, site_water
from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place

N_DRAWS = 4000
MONTHS = [f"[{low}, {2 * low}, {3 * low}] mm" for low in (1, 1, 0.8, 0.6, 0.5, 0.3, 0.2, 0.2, 0.3, 0.5, 0.7, 1)]
HOURS = [1 + 0.2 * math.sin(2 * math.pi * hour / 24) for hour in range(24)]
BAND = top_hat(280e9, 0.1)


@pytest.fixture(scope="module")
def air():
    keys = {"spectral_index": "11/3", "illuminated_aperture": "6 m", "site": "alma", "pwv_probabilities": [0, 0.5, 1]}
    return Atmosphere.model_validate(keys | {"pwv_by_month": MONTHS, "pwv_by_hour": HOURS})


@pytest.fixture(scope="module")
def water(air):
    return site_water(air, shipped_place("alma"), BAND)


def draws(air, water, when, n=N_DRAWS):
    rng = np.random.default_rng(3)
    return [draw_weather(air, water, rng, when) for _ in range(n)]


def share_error(share, n):
    return 5 * math.sqrt(share * (1 - share) / n)


@pytest.mark.parametrize("longitude_deg", [-155.5, -67.75, 0.0, 123.35, 270.0])
def test_months_and_hours_are_those_of_the_local_mean_sun(longitude_deg):
    """Against the calendar: four minutes of time for each degree east."""
    epoch, east = datetime(1858, 11, 17, tzinfo=UTC), math.remainder(longitude_deg, 360)
    mjd = np.random.default_rng(1).uniform(40_000, 70_000, 300)
    for days, found in zip(mjd.tolist(), seasons(mjd, math.radians(longitude_deg)), strict=True):
        local = epoch + timedelta(days=days, minutes=4 * east)
        assert found == Season(local.month - 1, local.hour)


@pytest.mark.parametrize("when", [Season(0, 6), Season(6, 18), Season(11, 0)])
def test_a_month_has_its_own_quantiles(air, water, when):
    low = float(MONTHS[when.month][1:].split(",")[0]) * HOURS[when.hour]
    pwv = np.array([item.pwv_mm for item in draws(air, water, when)])
    assert low <= pwv.min() and pwv.max() <= 3 * low * (1 + 1e-12)
    assert np.mean(pwv < 2 * low) == pytest.approx(0.5, abs=share_error(0.5, N_DRAWS))


@pytest.mark.slow
def test_without_dates_all_months_are_equally_likely(air, water):
    """A draw without a date has the distribution of draws with uniform dates."""
    year = np.array([item.pwv_mm for item in draws(air, water, None)])
    rng = np.random.default_rng(4)
    dated = np.concatenate([draws_once(air, water, rng) for _ in range(N_DRAWS)])
    for share in (0.1, 0.5, 0.9):
        expected = pwv_quantile(air, share)
        for found in (year, dated):
            assert np.mean(found < expected) == pytest.approx(share, abs=share_error(share, N_DRAWS))
    assert driest_mm(air) <= year.min() and year.max() <= wettest_mm(air)
    assert (driest_mm(air), wettest_mm(air)) == pytest.approx((0.2 * 0.8, 3 * 1.2))


def draws_once(air, water, rng):
    when = Season(int(rng.integers(12)), int(rng.integers(24)))
    return [draw_weather(air, water, rng, when).pwv_mm]


def test_b2_is_that_of_the_water_drawn(air, water):
    """B2 in two bands differs by the ratio of their responses to the water of the date, as without months."""
    other = site_water(air, shipped_place("alma"), top_hat(150e9, 0.1))
    when = Season(6, 3)
    for one, two in zip(draws(air, water, when, 50), draws(air, other, when, 50), strict=True):
        assert one.pwv_mm == two.pwv_mm
        expected = water.response(one.pwv_mm) / other.response(one.pwv_mm)
        assert one.b2 / two.b2 == pytest.approx(expected, rel=0.02)  # B2 is tabulated by rank


def test_quantiles_of_a_survey_are_those_of_its_dates(air, water):
    """A survey of January and July nights: B2 and water at three ranks against draws."""
    when = (Season(0, 2),) * 3 + (Season(6, 2),)
    found = [item for season in when for item in draws(air, water, season, 2000)]
    probability = (0.25, 0.5, 0.75)
    b2, pwv = season_quantiles(air, water, when, probability)
    for name, expected in (("b2", b2), ("pwv_mm", pwv)):
        values = np.array([getattr(item, name) for item in found])
        for share, value in zip(probability, expected, strict=True):
            # A percent is the width of a rank of the closed form.
            assert np.mean(values < value) == pytest.approx(share, abs=share_error(share, len(values)) + 0.01)
