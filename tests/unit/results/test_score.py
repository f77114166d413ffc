"""The list of scores: results follow the row alone."""

from dataclasses import replace

import pytest

from surveysim.reduction.setup import prepare
from surveysim.results import score
from surveysim.results.results import survey_result
from surveysim.results.score import FLAT_BAND_POWER, SCORES, scene_score
from surveysim.runtime.errors import InsufficientDataError
from surveysim.scene.scene import Scene, load_scene
from surveysim.survey.run import run_observations
from tests.scenes import SMALL_SCENE


@pytest.fixture
def setup(tmp_path):
    (tmp_path / "scene.toml").write_text(SMALL_SCENE)
    return prepare(load_scene(tmp_path / "scene.toml", {"observations": 4}))


def test_every_score_has_a_section(setup):
    assert {item.section for item in SCORES} <= set(Scene.model_fields)
    assert scene_score(setup.scene) is FLAT_BAND_POWER
    assert scene_score(setup.scene.model_copy(update={"score": None})) is None


def test_results_come_from_the_row(setup, monkeypatch):
    coadds = run_observations(setup, None)
    whole = survey_result(setup, coadds, wall_s=0.0, workers=1)
    half = replace(
        FLAT_BAND_POWER,
        measure=lambda setup, coadds: {"actual": FLAT_BAND_POWER.measure(setup, coadds)["actual"]},
        alternatives=lambda setup, coadds, scores: [{"weights": name} for name in scores],
        forecast=lambda setup, coadds: None,
    )
    monkeypatch.setattr(score, "SCORES", (half,))
    found = survey_result(setup, coadds, wall_s=0.0, workers=1)
    assert found.scores["actual"].band.sigma_ukcmb2 == whole.scores["actual"].band.sigma_ukcmb2
    assert whole.gains and whole.expected
    assert (list(found.scores), found.gains, found.alternatives) == (["actual"], {}, [{"weights": "actual"}])
    assert found.expected is None


def test_a_survey_that_cannot_be_scored_keeps_the_reason(setup, monkeypatch):
    def refuse(setup, coadds):
        raise InsufficientDataError("too few")

    monkeypatch.setattr(score, "SCORES", (replace(FLAT_BAND_POWER, measure=refuse),))
    found = survey_result(setup, run_observations(setup, None), wall_s=0.0, workers=1)
    assert (found.scores, found.unscored, found.expected) == ({}, "too few", None)
