"""A section [site], sites that ship, and water by month: what a scene accepts, supplies and refuses."""

import numpy as np
import pytest

from surveysim.atmosphere.opacity import optical_depth
from surveysim.atmosphere.opacity_tables import OFFSETS_K
from surveysim.atmosphere.standard_air import air_temperature_k
from surveysim.forecasting.observing_conditions import population_draws
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.place import own_place, shipped_place, usual_temperature_k
from surveysim.scene.scene import Scene, load_scene
from surveysim.scene.sites import OWN, site_names
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observing_site
from tests.scenes import SMALL_SCENE, without_sections, write_scene

PLACE = {"site.latitude": "-30 deg", "site.longitude": "-70.8 deg", "site.height": "4500 m"}
WATER = {"atmosphere.pwv": "[0.5, 1, 1.5, 2, 4] mm", "instrument.bandwidth": 0.15}
OWN_SITE = PLACE | WATER
DATES = """\
[schedule]
first_night = "2026-07-01"
nights = 4
max_hour_angle = "3 hourangle"
min_elevation = "30 deg"
"""
MONTHS = [f"[{month / 10}, {month / 10 + 0.05}] mm" for month in range(1, 13)]
BY_MONTH = PLACE | {
    "instrument.bandwidth": 0.15,
    "atmosphere.pwv_by_month": MONTHS,
    "atmosphere.pwv_probabilities": [0, 1],
}


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


@pytest.fixture
def dated(tmp_path):
    """A scene with dates, of a field that rises at 30 degrees south, and without B2 of its own."""
    fixed = '[fixed_pointing]\nelevation = "55 deg"\nparallactic_angle = "20 deg"\n'
    b2 = 'b2_probabilities = [0.25, 0.5, 0.75]\nb2 = "[100, 280, 980] mK2 rad(-5/3)"\n'
    text = (
        without_sections(SMALL_SCENE, "sky").replace(fixed, DATES).replace(b2, "").replace("+44d50m24s", "-40d00m00s")
    )
    assert DATES in text and b2 not in text
    path = tmp_path / "dated.toml"
    path.write_text(text)
    return path


def test_a_place_of_one_s_own(dated):
    """Its latitude, longitude and height are the schedule's, its opacity that of the height."""
    scene = load_scene(dated, OWN_SITE)
    assert scene.place == own_place(scene.site) and scene.atmosphere.site == OWN
    assert observing_site(scene).height_m == 4500
    assert observing_site(scene).latitude_rad == pytest.approx(np.radians(-30))
    low, high = (
        optical_depth(prepare(load_scene(dated, OWN_SITE | {"site.height": height})).air.water.opacity, 1.0)
        for height in ("4500 m", "2500 m")
    )
    assert 1.2 * low < high  # more dry air, and broader lines of as much water


def test_what_a_place_of_one_s_own_assumes_is_said(dated):
    assumed = " ".join(load_scene(dated, OWN_SITE).assumed)
    assert "atmosphere.water_fluctuation" in assumed and "atmosphere.layer_height" not in assumed


def test_months_of_a_schedule_are_drawn_and_forecast(dated):
    """July alone: the survey's weather and the population that its forecast averages over."""
    setup = prepare(load_scene(dated, BY_MONTH))
    drawn = [observation_weather(setup, number).pwv_mm for number in range(setup.scene.observations)]
    forecast = [weather.pwv_mm for draws in population_draws(setup) for _, weather in draws]
    for pwv_mm in (drawn, forecast):
        assert 0.7 <= min(pwv_mm) <= max(pwv_mm) <= 0.75 and len(set(pwv_mm)) == len(pwv_mm)


def test_months_at_a_fixed_pointing_are_all_year_s(path):
    setup = prepare(load_scene(path, BY_MONTH | {"observations": 200}))
    drawn = [observation_weather(setup, number).pwv_mm for number in range(200)]
    assert setup.air.dated is None and min(drawn) < 0.25 and max(drawn) > 1.1


@pytest.mark.parametrize("site", site_names())
def test_every_site_that_ships_can_be_observed_from(dated, site):
    """It supplies place, water and wind; a field 20 degrees from its zenith rises."""
    place = shipped_place(site)
    dec = np.degrees(place.latitude_rad) - 20 * np.sign(place.latitude_rad)
    changes = {"atmosphere.site": site, "instrument.bandwidth": 0.15, "field.dec": f"{dec:.3f} deg"}
    setup = prepare(load_scene(dated, changes))
    assert observing_site(setup.scene).height_m == place.height_m
    assert (setup.air.dated is not None) == bool(setup.scene.atmosphere.pwv_by_month)


@pytest.mark.parametrize("site", site_names())
def test_air_of_a_site_is_within_the_table_of_heights(site):
    place = shipped_place(site)
    for temperature_k in (place.temperature_k, usual_temperature_k(place.latitude_rad, place.height_m)):
        offset_k = temperature_k - air_temperature_k(place.height_m, 0.0)
        assert OFFSETS_K[0] < offset_k < OFFSETS_K[-1]
    # "within 12 K" of `usual_temperature_k`, for the sites with temperatures of ERA5.
    if place.opacity is None:
        assert usual_temperature_k(place.latitude_rad, place.height_m) == pytest.approx(place.temperature_k, abs=12)


def test_a_schedule_of_a_named_site_may_have_its_own_place(dated):
    changes = {"atmosphere.site": "alma", "instrument.bandwidth": 0.15}
    assert observing_site(load_scene(dated, changes)).height_m == 5060
    assert observing_site(load_scene(dated, changes | {"schedule.height": "5190 m"})).height_m == 5190


@pytest.mark.parametrize(
    "changes, words",
    [
        (OWN_SITE | {"site.latitude": "100 deg"}, "site.latitude: found '100 deg'; -90 deg to 90 deg is expected"),
        (OWN_SITE | {"site.height": None}, "site.height: missing"),
        (OWN_SITE | {"site.heigth": "4 km"}, "site.heigth: unknown key; did you mean site.height?"),
        (OWN_SITE | {"site.height": "7 km"}, "site: found a height of 7000 m; 0 to 6000 m is allowed"),
        (OWN_SITE | {"site.temperature": "200 K"}, "site: found 200 K at a height of 4500 m; 213.7 to 288.7 K"),
        (OWN_SITE | {"instrument.frequency": "1.2 THz"}, "site: found a band of 1110 to 1290 GHz; bands within 10 to"),
        (
            OWN_SITE | {"atmosphere.pwv": "[1, 2, 3, 4, 70] mm"},
            "atmosphere.pwv: found 70 mm of water vapour; 0.03 to 60",
        ),
        (OWN_SITE | {"atmosphere.site": "alma"}, "atmosphere.site: found 'alma' with a section [site]; one of them"),
        (OWN_SITE | {"schedule.height": "4 km"}, "schedule.height: found with a section [site]; it is expected there"),
        (OWN_SITE | {"site.opacity": "none.ecsv"}, "site.opacity: "),
        (PLACE | {"instrument.bandwidth": 0.15}, "atmosphere.pwv: missing; either 'pwv' or 'pwv_by_month' is expected"),
        (BY_MONTH | WATER, "atmosphere.pwv: found with 'pwv_by_month'; either"),
        (BY_MONTH | {"atmosphere.pwv_by_month": MONTHS[:11]}, "atmosphere.pwv_by_month: found 11 values; one for each"),
        (
            BY_MONTH | {"atmosphere.pwv_by_hour": [1, 2]},
            "atmosphere.pwv_by_hour: found 2 values; one for each hour, 24",
        ),
        (OWN_SITE | {"atmosphere.pwv_by_hour": [1] * 24}, "atmosphere.pwv_by_hour: found without 'pwv_by_month'"),
        (
            BY_MONTH | {"atmosphere.pwv_by_month": [*MONTHS[:11], "[2, 1] mm"]},
            "atmosphere.pwv_by_month: found (2.0, 1.0); values of 0 or more that do not decrease",
        ),
        (
            BY_MONTH | {"atmosphere.pwv_by_hour": [1] * 23 + [70]},
            "atmosphere.pwv_by_month: found 87.5 mm of water vapour; 0.03 to 60 mm is allowed",
        ),
        ({"atmosphere.site": OWN, "instrument.bandwidth": 0.15} | WATER, "site: missing; atmosphere.site 'own' is"),
    ],
)
def test_refused(dated, changes, words):
    with pytest.raises(SceneError) as caught:
        prepare(load_scene(dated, changes))
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_months_without_a_site(path):
    with pytest.raises(SceneError, match="atmosphere.site: missing; 'pwv_by_month' needs the opacity of a site"):
        load_scene(path, {"atmosphere.pwv_by_month": MONTHS})


def test_scenes_without_a_site_are_as_before(path):
    assert load_scene(path).place is None and "site" in Scene.model_fields
