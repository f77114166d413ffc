"""The whole suite on two cores; closed forms of scenes are kept, as many tests run the same small scene."""

import os

import pytest

import surveysim.forecasting.observing_conditions as conditions
from surveysim.runtime.once import keep_last

KEPT = 24  # scenes; a run keeps one


def keep(module, name):
    """Give a module's cached function room for more scenes, before others import it."""
    setattr(module, name, keep_last(KEPT)(getattr(module, name).__wrapped__))


keep(conditions, "population_conditions")

import surveysim.forecasting.noise_model as noise_model  # noqa: E402

keep(noise_model, "survey_models")

import surveysim.results.control_variate as control  # noqa: E402

keep(control, "expectations")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """Two processes for the whole suite, of which each imports and compiles; none for files or tests by name."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    return min(2, os.cpu_count() or 1) if whole else 0


def pytest_addoption(parser):
    group = parser.getgroup("surveysim")
    group.addoption("--fuzz", type=int, metavar="N", help="inputs that the slow test of mangled inputs tries")
    group.addoption("--fuzz-seed", type=int, default=1, metavar="SEED", help="seed of the mangled inputs")
    group.addoption(
        "--stress", type=int, metavar="N", help="kills that the slow stress tests try; a third as many pairs"
    )


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch):
    """Tables as wide as they are off a terminal: processes of pytest-xdist are told the width of the one they serve."""
    monkeypatch.delenv("COLUMNS", raising=False)
