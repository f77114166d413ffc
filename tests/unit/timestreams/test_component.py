"""The list of stream components: what draws, plans, reports and forecasts read from it."""

from dataclasses import replace

import numpy as np
import pytest

from surveysim.forecasting import forecast as forecasting
from surveysim.forecasting.closed_forms import CLOSED_FORMS
from surveysim.forecasting.forecast import forecast
from surveysim.reduction.setup import prepare
from surveysim.results.stages import left_out, stages_that_run
from surveysim.runtime.errors import NotForecastableError, SceneError
from surveysim.scene.noise_and_sky import StreamSections
from surveysim.scene.readout import ReadoutSections
from surveysim.scene.scene import load_scene
from surveysim.timestreams import component
from surveysim.timestreams.component import COMPONENTS, present_components
from surveysim.timestreams.observation import draw_observation
from tests.scenes import SMALL_SCENE, WHITE_NOISE_SCENE, write_scene


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SMALL_SCENE)
    return load_scene(path)


def test_every_component_has_a_section_and_those_that_are_seen_come_first():
    names = [item.name for item in COMPONENTS]
    assert sorted(names) == sorted({**StreamSections.model_fields, **ReadoutSections.model_fields})
    seen = [item.through_response for item in COMPONENTS]
    assert seen == sorted(seen, reverse=True)


def test_components_that_flag_samples_are_the_losses_of_a_scene(scene):
    every = scene.model_copy(update=dict.fromkeys(ReadoutSections.model_fields, True))
    assert every.losses == tuple(item.name for item in COMPONENTS if item.flag is not None)
    assert scene.losses == ()


def test_present_components(scene, tmp_path):
    assert [item.name for item in present_components(scene)] == ["atmosphere", "excess", "sky", "photon", "detector"]
    path = tmp_path / "white.toml"
    path.write_text(WHITE_NOISE_SCENE)
    assert [item.name for item in present_components(load_scene(path))] == ["detector"]


def test_no_turbulence_leaves_the_weather(tmp_path):
    """Streams without the layer are those of a scene without an atmosphere, and excess noise still knows B2."""
    path = write_scene(tmp_path)
    calm = {"atmosphere.turbulence": "none", "cleaning.responsivities": "known"}
    streams = [
        draw_observation(prepare(load_scene(path, settings)), 1)
        for settings in (
            calm | {"excess": None},
            {"atmosphere": None, "excess": None, "cleaning.algorithm": "none"},
            {"excess": None},
        )
    ]
    np.testing.assert_array_equal(streams[0].data_mk, streams[1].data_mk)
    assert (streams[0].data_mk != streams[2].data_mk).any()
    drawn = prepare(load_scene(path, calm))
    assert [item.name for item in present_components(drawn.scene)] == ["excess", "sky", "photon", "detector"]
    assert left_out(drawn)["atmosphere"] == "atmosphere.turbulence is 'none'"
    assert draw_observation(drawn, 1).attributes["b2_mk2"] == streams[2].attributes["b2_mk2"]
    assert (
        forecast(drawn).scores["actual"].band.sigma_ukcmb2
        < forecast(prepare(load_scene(path, {"cleaning.responsivities": "known"}))).scores["actual"].band.sigma_ukcmb2
    )
    with pytest.raises(SceneError, match="cleaning.responsivities: found 'scan' with 'average' and no turbulence"):
        prepare(load_scene(path, {"atmosphere.turbulence": "none"}))


@pytest.mark.parametrize("through_response", [True, False])
def test_a_component_is_drawn_planned_and_not_forecast_by_its_row_alone(scene, monkeypatch, through_response):
    """A constant in place of the detector noise: seen by each detector with its responsivity, or added after that."""
    setup = prepare(scene)

    def add(data_mk, of):
        data_mk += 1

    detector = next(item for item in COMPONENTS if item.name == "detector")
    row = replace(detector, add=add, through_response=through_response, sentence="a constant for a test")
    without = replace(row, add=lambda data_mk, of: None)
    streams = {}
    for item in (row, without):
        monkeypatch.setattr(component, "COMPONENTS", (item,))
        streams[item] = draw_observation(setup, 0).data_mk
    expected = setup.camera.responsivity[:, None] if through_response else 1
    np.testing.assert_array_equal(streams[row], np.broadcast_to(np.float32(expected), streams[row].shape))
    assert not streams[without].any()
    assert stages_that_run(setup)["detector"] == "a constant for a test"
    monkeypatch.delitem(CLOSED_FORMS, "detector")
    assert "forecast" not in stages_that_run(setup)
    with pytest.raises(NotForecastableError, match="detector: found a section without a closed form"):
        forecasting.forecast(prepare(scene))
