"""Fixtures of the physics tests."""

import pytest

from surveysim.forecasting.noise_model import survey_models
from surveysim.reduction.setup import prepare
from tests.dense import DENSE


@pytest.fixture
def few_are_many(monkeypatch):
    """Arrays of more than ten detectors count as too large for a matrix."""
    for module in DENSE:
        monkeypatch.setattr(module, "MOST_DENSE", 10)
    prepare.cache_clear()
    survey_models.cache_clear()
    yield
    prepare.cache_clear()
    survey_models.cache_clear()
