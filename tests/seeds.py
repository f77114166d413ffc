"""Surveys that differ in their seed alone share their closed forms, which take longer than the surveys themselves.

A seed shifts the lattice that samples the weather, which moves an expected PSD by less than 0.5 %, and draws the
responsivities, whose scatter of 5 % moves the forecast by about its square. Both are far below the errors of single
surveys that these tests are about.
"""

from contextlib import contextmanager

import pytest

import surveysim.forecasting.forecast as forecast
import surveysim.results.control_variate as control_variate


@contextmanager
def shared_expectations():
    """Forecasts over all weather, and the noise models that they contain, of seed 0 for all seeds."""
    expectations, models = control_variate.expectations, forecast.survey_models
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(control_variate, "expectations", lambda scene: expectations(_without_seed(scene)))
        patch.setattr(forecast, "survey_models", lambda scene: models(_without_seed(scene)))
        yield


def _without_seed(scene):
    return scene.model_copy(update={"seed": 0})
