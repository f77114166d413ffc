"""The whole suite on two cores, one BLAS thread each; closed forms of scenes are kept, as many tests share a scene."""

import gc
import os
from functools import lru_cache

import pytest
from threadpoolctl import threadpool_limits

import surveysim.forecasting.observing_conditions as conditions

KEPT = 24  # scenes; a run keeps one


def keep(module, name):
    """Give a module's cached function room for more scenes, before others import it."""
    setattr(module, name, lru_cache(maxsize=KEPT)(getattr(module, name).__wrapped__))


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


def pytest_collection_finish(session):
    """Keep collections of garbage off all that is imported, and BLAS to one thread: two processes share two cores."""
    gc.collect()
    gc.freeze()
    threadpool_limits(1)


@pytest.fixture
def two_threads():
    """BLAS with two threads in this process, for tests of results that must not depend on their number."""
    with threadpool_limits(2):
        yield


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
