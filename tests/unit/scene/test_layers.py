"""Layers of the atmosphere in a scene: what it accepts, fills in and refuses."""

import math

import numpy as np
import pytest

from surveysim.atmosphere.layers import b2_factor, dominant_layer, layer_sections, wind_factor
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from tests.refusals import scene_refusal
from tests.scenes import write_scene

LOW = {"name": "low", "height": "500 m", "share": 0.75}
HIGH = {"name": "high", "height": "2 km", "share": 0.25, "wind_factor": 3, "wind_turn": "120 deg"}


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path)


def air(path, **keys):
    return load_scene(path, {f"atmosphere.{key}": value for key, value in keys.items()}).atmosphere


def test_without_layers_there_is_one(path):
    atmosphere = air(path, decorrelation_time="1 min")
    (layer,) = layer_sections(atmosphere)
    assert (layer.height_m, layer.share, layer.spectral_index) == (1000, 1, atmosphere.spectral_index)
    assert layer.decorrelation_time_s == 60
    assert b2_factor(atmosphere, layer) == 1 and wind_factor(atmosphere, layer) == 1


def test_layers_take_what_they_leave_out_from_the_atmosphere(path):
    drift = {"speed_rms": 0.1, "time_scale": "5 min"}
    own = {"outer_scale": "2 km", "wind_drift": drift | {"speed_rms": 0.3}}
    atmosphere = air(path, outer_scale="500 m", wind_drift=drift, layers=[LOW, HIGH | own])
    low, high = layer_sections(atmosphere)
    assert (low.outer_scale_m, high.outer_scale_m) == (500, 2000)
    assert (low.wind_drift.speed_rms, high.wind_drift.speed_rms) == (0.1, 0.3)
    assert dominant_layer(atmosphere).name == "low"


def test_wind_in_m_s_is_that_of_the_reference_height(path):
    """The drawn angular speed is that at 1000 m; at equal speeds in m/s a layer at 500 m is twice as fast."""
    atmosphere = air(path, layers=[LOW, HIGH])
    assert [wind_factor(atmosphere, layer) for layer in layer_sections(atmosphere)] == pytest.approx([2, 1.5])


def test_spectra_of_other_indices_agree_at_the_pivot(path):
    pivot = math.radians(8 / 60)
    atmosphere = air(path, layers=[LOW, HIGH | {"spectral_index": "8/3", "pivot": "8 arcmin"}])
    high = layer_sections(atmosphere)[1]
    own, scene = (1 / pivot) ** -high.spectral_index, (1 / pivot) ** -atmosphere.spectral_index
    assert b2_factor(atmosphere, high) * own == pytest.approx(0.25 * scene)


def test_exponential_profile(path):
    """Shares over h^(5/3) are weights of a quadrature for exp(-2 h / H), whose moments are factorials."""
    atmosphere = air(path, profile="exponential", profile_layers=3, water_scale_height="2 km")
    layers = layer_sections(atmosphere)
    height, share = (np.array([getattr(layer, key) for layer in layers]) for key in ("height_m", "share"))
    weight = share / height ** (5 / 3)
    moments = [weight @ (height / 1000) ** power / weight.sum() for power in range(6)]
    assert moments == pytest.approx([1, 1, 2, 6, 24, 120]) and share.sum() == pytest.approx(1)
    assert len({layer.name for layer in layers}) == 3


def test_a_site_has_a_scale_height(path):
    """It is one of the scene's assumed values where the scene has a profile."""
    site = {"atmosphere.site": "alma", "instrument.bandwidth": 0.15}
    assert load_scene(path, site).atmosphere.water_scale_height_m is None
    scene = load_scene(path, site | {"atmosphere.profile": "exponential", "atmosphere.layer_height": None})
    assert scene.atmosphere.water_scale_height_m == 2000 and len(layer_sections(scene.atmosphere)) == 4
    of_height = [line for line in scene.assumed if "layer_height" in line]
    assert of_height[0].endswith("; beside other layers, only the height of the drawn wind")
    assert any(line.startswith('atmosphere.water_scale_height = "2 km": assumed') for line in scene.assumed)


@pytest.mark.parametrize(
    "keys, words",
    [
        ({"layers": [LOW]}, ("shares that sum to 0.75", "1 is expected")),
        ({"layers": [LOW, HIGH | {"name": "low"}]}, ("atmosphere.layers.1.name", "different names")),
        ({"layers": [LOW | {"height": "5 m"}, HIGH]}, ("atmosphere.layers.0.height", "no less than the aperture")),
        (
            {"layers": [LOW | {"outer_scale": "5 m"}, HIGH]},
            ("atmosphere.layers.0.outer_scale", "no less than the aperture"),
        ),
        ({"layers": [LOW, HIGH | {"spectral_index": 3}]}, ("atmosphere.layers.1.pivot: missing",)),
        ({"layers": [LOW, HIGH | {"pivot": "1 arcmin"}]}, ("atmosphere.layers.1.pivot", "without a 'spectral_index'")),
        (
            {"layers": [LOW, HIGH | {"spectral_index": 5, "pivot": "1 arcmin"}]},
            ("atmosphere.layers.1.outer_scale: missing", "needs an outer scale"),
        ),
        ({"layers": [LOW | {"sahre": 1}, HIGH]}, ("sahre: unknown key",)),
        ({"layers": [LOW, HIGH], "profile": "exponential"}, ("profile: found with 'layers'",)),
        ({"profile": "exponential"}, ("water_scale_height: missing",)),
        ({"profile_layers": 3}, ("profile_layers: found without 'profile'",)),
        ({"water_scale_height": "2 km"}, ("water_scale_height: found without 'profile'",)),
        ({"wind_drift": {"time_scale": "1 min"}}, ("speed_rms: missing",)),
        ({"wind_drift": {"speed_rms": 0.1}}, ("time_scale: missing",)),
    ],
)
def test_refusals(path, keys, words):
    text = scene_refusal(path, {f"atmosphere.{key}": value for key, value in keys.items()})
    assert all(word in text for word in words), text


@pytest.mark.parametrize(
    "keys, words",
    [
        ({"decorrelation_time": "0.5 s"}, ("atmosphere.decorrelation_time: found 0.5 s; 0.6 s or more",)),
        ({"layers": [LOW, HIGH | {"decorrelation_time": "0.5 s"}]}, ("atmosphere.layers.1.decorrelation_time",)),
        (
            {"wind_drift": {"speed_rms": 0.1, "time_scale": "5 s"}},
            ("atmosphere.wind_drift.time_scale: found 5 s",),
        ),
        (
            {"layers": [LOW, HIGH | {"height": "10 m", "wind_factor": 100}]},
            ("tracks through the layer", "this is the layer 'high'"),
        ),
    ],
)
def test_scans_refuse_fast_changes_and_long_tracks(path, keys, words):
    with pytest.raises(SceneError) as error:
        prepare(load_scene(path, {f"atmosphere.{key}": value for key, value in keys.items()}))
    assert all(word in str(error.value) for word in words), error.value


def test_a_profile_whose_lowest_layer_is_in_the_aperture_is_refused(path):
    atmosphere = air(path, profile="exponential", profile_layers=20, water_scale_height="60 m")
    with pytest.raises(SceneError, match="profile_layers: found 20, the lowest at .* fewer are expected"):
        layer_sections(atmosphere)
