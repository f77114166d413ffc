"""Layer and forecast of a band in a water line, away from the zenith: the slant column's effect on the band."""

from dataclasses import replace

import numpy as np
import pytest

from surveysim.atmosphere.opacity import band_opacity, slant_factor, spectral_depth
from surveysim.atmosphere.weather import Weather, slant_b2
from surveysim.forecasting.observing_conditions import observing_conditions
from surveysim.reduction.setup import prepare
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place
from surveysim.scene.scene import load_scene
from surveysim.timestreams.atmosphere import add_layers
from surveysim.timestreams.simulation import observation_path
from tests.scenes import SMALL_SCENE, without_sections

WEATHER = Weather(b2=300.0, wind_speed_rad_s=9e-3, wind_angle_rad=0.4, pwv_mm=1.0)
FREQUENCY_HZ, BANDWIDTH, ELEVATION = 350e9, 0.2, 30.0  # airmass 2, with the lines of 325 and 380 GHz in the band


@pytest.fixture
def setups(tmp_path):
    """A scene of ALMA's site, and the same without a site."""
    path = tmp_path / "scene.toml"
    path.write_text(without_sections(SMALL_SCENE, "excess", "photon", "detector", "sky", "score"))
    band = {"instrument.frequency": "350 GHz", "instrument.bandwidth": BANDWIDTH, "numerics.precision": "float64"}
    band |= {"fixed_pointing.elevation": f"{ELEVATION} deg"}
    return prepare(load_scene(path, band | {"atmosphere.site": "alma"})), prepare(load_scene(path, band))


def spectral_factor():
    """Change of the band's emission over its transmission by the slant column, at ELEVATION over the zenith, squared.

    From the spectrum at the nodes of the band.
    """
    opacity = band_opacity(shipped_place("alma"), top_hat(FREQUENCY_HZ, BANDWIDTH))
    weight, step, change = opacity.band.nodes[1], 1e-3, []
    for airmass in (1 / np.sin(np.radians(ELEVATION)), 1.0):
        wet, dry = (weight @ np.exp(-airmass * spectral_depth(opacity, 1.0 + item)) for item in (step, -step))
        change.append((dry - wet) / (dry + wet) / step / airmass)
    return (change[0] / change[1]) ** 2


def test_factor_of_the_spectrum():
    """Within 1 %: the spectrum is linear between the cells of the table."""
    opacity = band_opacity(shipped_place("alma"), top_hat(FREQUENCY_HZ, BANDWIDTH))
    assert slant_factor(opacity, 1.0, airmass=2.0) == pytest.approx(spectral_factor(), rel=0.01)
    assert spectral_factor() < 0.65


def test_streams_of_the_layer(setups):
    """The same random numbers: the layer differs by the root of the factor, and without a site by nothing."""
    drawn = []
    for setup in setups:
        path, pointing = observation_path(setup.observing, 0)
        data = np.zeros((setup.camera.n_det, len(path.time_s)))
        add_layers(setup, 0, pointing, weather=WEATHER, data=data)
        drawn.append(data)
    ratio = np.sqrt(np.mean(drawn[0] ** 2) / np.mean(drawn[1] ** 2))
    np.testing.assert_allclose(drawn[0], ratio * drawn[1], rtol=1e-9, atol=1e-9 * drawn[1].std())
    assert ratio == pytest.approx(np.sqrt(spectral_factor()), rel=0.005)


def test_forecast_has_the_layer_of_the_streams(setups):
    site, plain = (observing_conditions(setup, [(0, WEATHER)]).layers[0, 0] for setup in setups)
    assert plain == pytest.approx(300.0 * 2 ** (8 / 3), rel=1e-12)
    assert site / plain == pytest.approx(spectral_factor(), rel=0.01)


def test_at_the_zenith_and_without_a_site_b2_is_the_drawn_one(setups):
    site, plain = setups
    assert slant_b2(site.air.water, [WEATHER], [np.pi / 2]) == [WEATHER.b2]
    assert slant_b2(plain.air.water, [WEATHER], [0.3]) == [WEATHER.b2]


def test_every_observation_has_its_water_and_elevation(setups):
    water, weather = setups[0].air.water, [replace(WEATHER, pwv_mm=pwv) for pwv in (0.5, 1.0, 2.0, 0.5)]
    elevation = np.radians([30.0, 60.0, 30.0, 45.0])
    found = slant_b2(water, weather, elevation)
    for b2, item, height in zip(found, weather, elevation, strict=True):
        assert b2 == pytest.approx(
            300 * slant_factor(water.opacity, item.pwv_mm, airmass=1 / np.sin(height)), rel=1e-13
        )
    assert len(np.unique(found)) == 4
