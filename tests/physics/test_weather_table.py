"""Weather of real nights: a table in place of distributions, at the middle of each observation."""

import math

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import AltAz, EarthLocation, SkyCoord
from astropy.table import QTable
from astropy.time import Time

from surveysim.forecasting.observing_conditions import population_draws
from surveysim.reduction.setup import prepare
from surveysim.results.sensitivity import survey_pwv_quantile
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from surveysim.telescope.scans import duration_s
from surveysim.timestreams.observed_block import observation_weather
from tests.scenes import SCHEDULE, SMALL_SCENE, without_sections, write_scene

NIGHTS = without_sections(SMALL_SCENE, "fixed_pointing").replace("observations = 4", "observations = 24")
NIGHTS += SCHEDULE.replace("nights = 1", "nights = 6")
MJD = np.arange(52941.0, 52947.0, 1 / 48)
HOURS = (MJD - MJD[0]) * 24
SITE = {"atmosphere.site": "mauna_kea", "instrument.bandwidth": 0.15}
PWV = (2 + np.sin(HOURS / 5)) * u.mm
FLUCTUATION = 1e-5 * (2 + np.cos(HOURS / 7)) * u.rad ** (-5 / 3)
B2 = 100 * (2 + np.sin(HOURS / 3)) * u.mK**2 * u.rad ** (-5 / 3)
SPEED = (10 + HOURS / 10) * u.m / u.s
HEIGHT_M = 1000.0
FIXED = {"schedule": None, "fixed_pointing.elevation": "50 deg", "fixed_pointing.parallactic_angle": "0 deg"}


@pytest.fixture
def made(tmp_path):
    """Make a setup from columns of a table and more keys."""

    def make(columns, keys=None):
        QTable({"time": Time(MJD, format="mjd"), **columns}).write(tmp_path / "nights.ecsv", overwrite=True)
        path = write_scene(tmp_path, NIGHTS)
        return prepare(load_scene(path, {"atmosphere.weather_table": "nights.ecsv"} | (keys or {})))

    return make


def middles(setup):
    return setup.observing.angles.start_mjd + duration_s(setup.observing.scans) / 2 / 86400


def weather_of(setup):
    return [observation_weather(setup, number) for number in range(setup.scene.observations)]


def test_rows_are_interpolated_to_the_middle_of_observations(made):
    setup = made({"b2": B2, "wind_speed": 2 * B2.value * u.arcmin / u.s})
    expected = np.interp(middles(setup), MJD, B2.value)
    found = weather_of(setup)
    np.testing.assert_allclose([item.b2 for item in found], expected, rtol=1e-12)
    np.testing.assert_allclose([math.degrees(item.wind_speed_rad_s) * 30 for item in found], expected, rtol=1e-12)
    angles = [item.wind_angle_rad for item in found]  # drawn, as without a table
    assert angles == [item.wind_angle_rad for item in weather_of(prepare(load_scene(setup.scene.origin.path)))]


def test_b2_follows_from_water_and_fluctuation(made):
    setup = made({"pwv": PWV, "water_fluctuation": FLUCTUATION}, SITE)
    mjd, found = middles(setup), weather_of(setup)
    pwv = np.interp(mjd, MJD, PWV.value)
    np.testing.assert_allclose([item.pwv_mm for item in found], pwv, rtol=1e-12)
    expected = setup.air.water.response(pwv) * np.interp(mjd, MJD, FLUCTUATION.value)
    np.testing.assert_allclose([item.b2 for item in found], expected, rtol=1e-9)
    assert survey_pwv_quantile(setup.scene.atmosphere, setup.air.dated, 0.5) == pytest.approx(np.median(pwv))


def test_drawn_fluctuations_scale_the_known_water(made):
    """Without quantiles of B2, twice the response of the water is twice B2, outside of the site's water too."""
    keys = SITE | {"atmosphere.b2": None, "atmosphere.b2_probabilities": None}
    setups = [made({"pwv": PWV / factor}, keys) for factor in (1, 8)]
    wet, dry = (np.array([item.b2 for item in weather_of(setup)]) for setup in setups)
    response = [setup.air.water.response(setup.air.dated.known["pwv"]) for setup in setups]
    np.testing.assert_allclose(wet / dry, response[0] / response[1], rtol=1e-9)


def test_wind_is_that_of_a_parcel_of_the_layer(made):
    """Against the motion of a point at the height of the layer, in the frame of astropy's azimuth and elevation.

    A layer turns by v sin(el) / h in azimuth. In elevation it is v sin(el)^2 / h; the model's layer is isotropic.
    """
    comes_from_deg = (330 + HOURS) % 360  # through north
    setup = made({"wind_speed": SPEED, "wind_direction": comes_from_deg * u.deg})
    mjd, plan, field = middles(setup), setup.scene.schedule, setup.scene.field
    lon, lat = plan.longitude_rad * u.rad, plan.latitude_rad * u.rad
    frame = AltAz(obstime=Time(mjd, format="mjd"), location=EarthLocation(lon=lon, lat=lat, height=plan.height_m * u.m))
    seen = SkyCoord(ra=field.ra_rad * u.rad, dec=field.dec_rad * u.rad).transform_to(frame)
    az, el = seen.az.rad, seen.alt.rad
    speed = np.interp(mjd, MJD, SPEED.value)
    to = np.radians(np.interp(mjd, MJD, 330 + HOURS)) + np.pi
    start = HEIGHT_M * np.array([np.sin(az) / np.tan(el), np.cos(az) / np.tan(el), np.ones_like(az)])
    end = start + 1e-3 * speed * np.array([np.sin(to), np.cos(to), np.zeros_like(to)])
    turned = (np.arctan2(end[0], end[1]) - az + np.pi) % (2 * np.pi) - np.pi
    risen = np.arctan2(end[2], np.hypot(end[0], end[1])) - el
    expected = np.array([turned * np.cos(el), risen / np.sin(el)]).T / 1e-3
    found = np.array([item.wind_rad_s for item in weather_of(setup)])
    # The closed form of the direction leaves out aberration and nutation, some 1e-4 rad.
    np.testing.assert_allclose(found, expected, atol=1e-3 * speed.max() / HEIGHT_M)


def test_forecasts_are_over_the_observations_own_weather(made):
    setup = made({"b2": B2, "wind_speed": SPEED, "wind_direction": np.full(len(MJD), 90) * u.deg})
    own = weather_of(setup)
    draws = [draw for draws in population_draws(setup) for draw in draws]
    assert {number for number, _ in draws} == set(range(24))
    assert all(weather == own[number] for number, weather in draws)
    assert setup.air.dated.sampling_factor(with_water=False) == 0
    assert setup.air.dated.sampling_factor(with_water=True) == 1


def test_distributions_may_be_left_out(made):
    left_out = dict.fromkeys(
        f"atmosphere.{key}" for key in ("b2", "b2_probabilities", "wind_median", "wind_log_scatter")
    )
    air = made({"b2": B2, "wind_speed": SPEED}, left_out).scene.atmosphere
    np.testing.assert_allclose(air.b2, np.quantile(B2.value, air.b2_probabilities), rtol=1e-12)
    assert air.wind_median_rad_s == pytest.approx(np.median(SPEED.value) / HEIGHT_M, rel=1e-12)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"schedule.nights": 12},
            "covers 2003-10-29T00:00 to 2003-11-03T23:30 UTC; 12 of 24 observations lie outside",
        ),
        (
            {"schedule.first_night": "2003-12-28"},
            "24 of 24 observations lie outside, the first, number 0, at 2003-12",
        ),
        (
            {"fixed_pointing": {"elevation": "50 deg", "parallactic_angle": "0 deg"}, "schedule": None},
            r"\[schedule\] is",
        ),
        (
            {"atmosphere.wind_b2_exponent": 0.3},
            "wind_b2_exponent: found 0.3 with the B2 of 'weather_table'; 0, or a",
        ),
    ],
)
def test_observations_that_the_table_does_not_cover_are_refused(made, keys, words):
    with pytest.raises(SceneError, match=words):
        made({"b2": B2}, keys)


def test_gaps_are_refused(made, tmp_path, monkeypatch):
    kept = (MJD < 52943.3) | (MJD > 52944.4)
    monkeypatch.setitem(globals(), "MJD", MJD[kept])
    with pytest.raises(SceneError, match="has no row from 2003-10-31T07:00 to 2003-11-01T10:00 UTC; 4 of 24"):
        made({"b2": B2[kept]})


def test_water_beyond_the_table_of_opacity_is_refused(made):
    with pytest.raises(SceneError, match="atmosphere.weather_table: found .* mm of water vapour; .* mm is allowed"):
        made({"pwv": 10 * PWV}, SITE)
