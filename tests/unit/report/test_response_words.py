"""Steps of the response on the page of a run, in a plan and in a check: a sentence for each that is present."""

import json

import pytest

from surveysim.reduction.setup import prepare
from surveysim.report.html.scene import scene_terms
from surveysim.report.terminal.camera import camera_lines
from surveysim.results.stages import stages_that_run
from surveysim.scene.scene import load_scene, resolved
from tests.scenes import write_scene

SETTINGS = {
    "responsivity_drift.rms": 0.01,
    "responsivity_drift.time_scale": "120 s",
    "responsivity_drift.load_coefficient": "0.005 / K",
    "responsivity_drift.load_scatter": 0.1,
    "time_constants.value": "20 ms",
    "time_constants.scatter": 0.2,
    "time_constants.deconvolution_error": 0.05,
    "crosstalk.neighbour_fraction": 0.005,
    "crosstalk.group_size": 6,
    "pointing_errors.jitter": "2 arcsec",
    "pointing_errors.drift": "4 arcsec",
    "pointing_errors.drift_time_scale": "300 s",
}
WORDS = {
    "Responsivity drift": "Responsivities drift by 1 % rms within 120 s, each detector by itself. They fall by 0.5 %,"
    " with a scatter of 10 %, for each K of load beyond that of the observation.",
    "Time constants": "20 ms with a scatter of 20 %. Streams are deconvolved with time constants that are wrong by 5 %"
    " rms.",
    "Crosstalk": "0.5 % of each stream in its neighbours in readout. Groups have 6 detectors.",
    "Pointing errors": "Jitter of 2 arcsec in each sample. A drift of 4 arcsec within 300 s. All are the rms along an"
    " axis.",
}
STEPS = ["pointing_errors", "responsivity_drift", "time_constants", "crosstalk", "deconvolution"]


@pytest.mark.parametrize("settings", [SETTINGS, {}])
def test_each_step_is_told_where_it_is_present(tmp_path, settings):
    setup = prepare(load_scene(write_scene(tmp_path), settings))
    terms = dict(scene_terms(json.loads(resolved(setup.scene)), setup.camera.n_det))
    assert {title: words for title, words in terms.items() if title in WORDS} == (WORDS if settings else {})
    told = [name for name in stages_that_run(setup) if name in STEPS]
    assert told == (STEPS if settings else [])
    lines = list(camera_lines(setup))
    assert [line.partition(": ")[0].replace(" ", "_") for line in lines[1:]] == told
    assert "crosstalk: streams leak into the streams of other detectors of their readout group" in lines or not settings
