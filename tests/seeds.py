"""Surveys that differ in their seed alone share their closed forms, which take longer than the surveys themselves.

A seed shifts the lattice that samples the weather, which moves an expected PSD by less than 0.5 %, and draws the
responsivities, whose scatter of 5 % moves the forecast by about its square. Both are far below the errors of single
surveys that these tests are about.
"""

from contextlib import contextmanager
from functools import lru_cache

import pytest

import surveysim.forecasting.forecast as forecast
import surveysim.results.control_variate as control_variate
from surveysim.reduction.setup import prepare


@contextmanager
def shared_expectations():
    """Forecasts over all weather, and the noise models that they contain, of seed 0 for all seeds."""
    expectations, models = control_variate.expectations, forecast.survey_models
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(control_variate, "expectations", lambda setup: expectations(_of_seed_0(setup)))
        patch.setattr(forecast, "survey_models", lambda setup: models(_of_seed_0(setup)))
        yield


def _of_seed_0(setup):
    return _prepared(setup.scene.model_copy(update={"seed": 0}))


@lru_cache(maxsize=4)
def _prepared(scene):
    return prepare(scene)
