"""The table of closed forms: noise models follow its rows alone."""

import numpy as np
import pytest

from surveysim.forecasting.closed_forms import CLOSED_FORMS
from surveysim.forecasting.noise_model import noise_models
from surveysim.forecasting.observing_conditions import observing_conditions, survey_draws
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene
from surveysim.timestreams.component import COMPONENTS
from tests.scenes import SMALL_SCENE

ROWS = dict(CLOSED_FORMS)


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "scene.toml"
    path.write_text(SMALL_SCENE)
    return prepare(load_scene(path))


@pytest.fixture(scope="module")
def conditions(setup):
    return observing_conditions(setup, survey_draws(setup, 0, 3))


def noise_of(setup, conditions):
    return {model.name: model.noise(conditions) for model in noise_models(setup, conditions)}


def test_rows_are_those_of_components():
    assert set(CLOSED_FORMS) <= {item.name for item in COMPONENTS}


def test_a_row_alone_adds_its_noise_to_all_data_sets(setup, conditions, monkeypatch):
    before = noise_of(setup, conditions)

    def two(bins):
        n_bin = len(bins.white(None))
        return lambda conditions: np.full((len(conditions.sine), n_bin), 2.0)

    monkeypatch.setitem(CLOSED_FORMS, "sky", (two,))
    after = noise_of(setup, conditions)
    assert {"actual", "uncorrelated", "white"} <= after.keys() == before.keys()
    for name, noise in after.items():
        np.testing.assert_allclose(noise - before[name], 2, rtol=1e-9)


def test_noise_is_the_sum_of_the_rows_and_common_terms_count_once(setup, conditions, monkeypatch):
    """White noise of photons and detectors is one term, that both rows name."""
    whole, parts = noise_of(setup, conditions), []
    for names in (("photon", "detector"), ("excess",), ("atmosphere",)):
        for name in CLOSED_FORMS:
            monkeypatch.setitem(CLOSED_FORMS, name, ROWS[name] if name in names else ())
        parts.append(noise_of(setup, conditions))
    for name, noise in whole.items():
        np.testing.assert_allclose(sum(part[name] for part in parts), noise, rtol=1e-12)
        assert all((part[name] >= 0).all() and part[name].any() for part in parts)
