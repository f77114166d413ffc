"""Bands of one camera: one layer and one sky in all, and noise of their own."""

import numpy as np
import pytest

from surveysim.atmosphere.opacity import band_opacity, slant_factor
from surveysim.reduction.setup import prepare
from surveysim.scene.bands import load_bands
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place
from surveysim.timestreams.observation import draw_observation
from tests.cameras import LAYER_BANDS, TWO_BANDS, write_camera
from tests.scenes import without_sections

LAYERS = {
    "atmosphere.layers": [
        {"name": "low", "height": "600 m", "share": 0.6, "decorrelation_time": "9 s"},
        {"name": "high", "height": "2 km", "share": 0.4, "wind_turn": "120 deg"},
    ],
    "atmosphere.wind_drift": {"speed_rms": 0.2, "direction_rms": "10 deg", "time_scale": "1 min"},
}
EXACT = {"numerics.precision": "float64", "instrument.responsivity_scatter": 0}


@pytest.fixture
def drawn(tmp_path):
    """Streams of an observation in each band."""

    def drawn(text, observation=1, **overrides):
        scenes = load_bands(write_camera(tmp_path, text), overrides)
        return {name: draw_observation(prepare(scene), observation) for name, scene in scenes.bands.items()}

    return drawn


def layer_b2(streams, frequency_hz):
    """B2 of the layer at the elevation of an observation."""
    opacity, at = band_opacity(shipped_place("mauna_kea"), top_hat(frequency_hz, 0.15)), streams.attributes
    airmass = 1 / np.sin(np.radians(at["elevation_deg"]))
    return at["b2_mk2"] * slant_factor(opacity, at["pwv_mm"], airmass=airmass)


@pytest.mark.parametrize("observation", [0, 3])
@pytest.mark.parametrize(("blocks", "layers"), [("250 MB", {}), ("9 kB", {}), ("9 kB", LAYERS)])
def test_detectors_at_one_position_see_one_layer(drawn, observation, blocks, layers):
    """Bands of 18 and 6 detectors: the inner ring is at the same positions, and the amplitudes have one ratio."""
    found = drawn(LAYER_BANDS, observation, **EXACT, **{"numerics.max_block_memory": blocks}, **layers)
    wide, narrow = found["150"], found["220"]
    places = [np.stack([item.focal_plane.x_rad, item.focal_plane.y_rad], axis=-1) for item in (wide, narrow)]
    same = [int(np.argmin(np.hypot(*(places[0] - place).T))) for place in places[1]]
    np.testing.assert_allclose(places[0][same], places[1], atol=1e-15)
    ratio = np.sqrt(layer_b2(narrow, 220e9) / layer_b2(wide, 150e9))
    assert ratio > 1.2  # the atmosphere is brighter at 220 GHz
    np.testing.assert_allclose(narrow.data_mk, ratio * wide.data_mk[same], rtol=1e-6, atol=1e-6 * wide.data_mk.std())


def test_a_band_without_the_others_sees_another_layer(drawn):
    """The extent of all bands makes the layer: the outer ring of one band changes that of the inner detectors."""
    both = drawn(LAYER_BANDS, **EXACT)["220"].data_mk
    alone = drawn(LAYER_BANDS.replace('[bands.150.instrument]\nfrequency = "150 GHz"\n', ""), **EXACT)["220"].data_mk
    assert both.shape == alone.shape and not np.allclose(both, alone, rtol=0.1)


def test_pointing_and_weather_are_the_same(drawn):
    wide, narrow = drawn(TWO_BANDS).values()
    for name in ("time_s", "ra_rad", "dec_rad", "array_angle_rad"):
        np.testing.assert_array_equal(getattr(wide, name), getattr(narrow, name))
    same = {"pwv_mm", "wind_speed_arcmin_s", "wind_angle_deg", "camera_angle_deg", "elevation_deg", "start_mjd_utc"}
    assert {key: wide.attributes[key] for key in same} == {key: narrow.attributes[key] for key in same}


def test_the_sky_is_the_same_behind_beams_of_their_own(tmp_path):
    """In CMB temperature: modes far longer than both beams agree, short ones go with the beams."""
    scenes = load_bands(write_camera(tmp_path), {"sky.point_sources": []}).bands
    wide, narrow = (prepare(scene).sky.map_mk[0] * scene.instrument.cmb_per_rj for scene in scenes.values())
    ratio = np.abs(np.fft.rfft2(narrow) / np.fft.rfft2(wide))
    assert ratio[1, 1] == pytest.approx(1, rel=0.01)
    assert np.median(ratio[len(ratio) // 4, ratio.shape[1] // 4 :]) > 1.5  # 40 arcsec against 60


@pytest.mark.parametrize("section", ["photon", "detector", "excess"])
def test_noise_is_independent_between_bands(drawn, section):
    """Correlation of all detectors at the same positions: 0 within 4 deviations of the number of samples."""
    others = {"atmosphere", "excess", "photon", "detector", "sky", "score"} - {section}
    text = without_sections(TWO_BANDS, *others).replace('algorithm = "average"', 'algorithm = "none"')
    text = text.replace("b2 = [46, 580]\n", "b2 = [46]\n").replace("[2.05, 4.52] mK2", "[2.05] mK2")
    text = text.replace('\n[bands.220.detector]\npsd = "4 mK2 / Hz"\n', "").replace(
        "[bands.220.instrument.layout]\nrings = 1\n", ""
    )
    wide, narrow = drawn(text, **EXACT).values()
    # Low-frequency noise has few independent values; differences along time make it nearly white.
    a, b = (np.diff(item.data_mk, axis=1) if section == "excess" else item.data_mk for item in (wide, narrow))
    assert a.shape == b.shape and a.std() == pytest.approx(b.std(), rel=0.2)
    correlation = (a * b).mean() / (a.std() * b.std())
    # A tenth of the photon noise is common to neighbours: fewer independent values by a factor of at most 2.
    assert abs(correlation) < 4 * np.sqrt(2 / a.size)


def test_responsivities_are_independent_between_bands(tmp_path):
    text = TWO_BANDS.replace("rings = 1", "rings = 2\ndead = [5]")
    first, second = (
        prepare(scene).camera.responsivity for scene in load_bands(write_camera(tmp_path, text)).bands.values()
    )
    assert len(first) == len(second) and abs(np.corrcoef(first, second)[0, 1]) < 4 / np.sqrt(len(first) - 3)
    assert np.abs(first - second).max() > 0.01
