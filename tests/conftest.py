"""The whole suite on two cores, one BLAS thread each; closed forms of scenes are kept, as many tests share a scene."""

import gc
import os
from importlib import import_module
from pathlib import Path

import pytest
from threadpoolctl import threadpool_limits

from tests.entry import READERS_PATH

ROOT = Path(__file__).parents[1]
KEPT = 24  # scenes; a run keeps one
CLOSED_FORMS = {  # in the order of their imports, as each module imports the functions of those before
    "surveysim.forecasting.observing_conditions": "population_conditions",
    "surveysim.forecasting.noise_model": "survey_models",
    "surveysim.results.control_variate": "expectations",
}


def pytest_configure():
    """Let commands of the tests run the code of this tree, with its compiled kernels, and not an installed one."""
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), READERS_PATH]))


def pytest_sessionstart(session):
    """Give cached functions room for more scenes, before tests import them; not where workers run the tests."""
    if session.config.getoption("dist", "no") != "no":
        return
    from surveysim.runtime.once import keep_last

    for path, name in CLOSED_FORMS.items():
        module = import_module(path)
        setattr(module, name, keep_last(KEPT)(getattr(module, name).__wrapped__))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers(config):
    """Two processes for the whole suite, of which each imports and compiles; none for files or tests by name."""
    whole = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    return min(2, os.cpu_count() or 1) if whole else 0


def pytest_collection_finish(session):
    """Keep collections of garbage off all that is imported, BLAS to one thread, and files off the disk's own pace."""
    gc.collect()
    gc.freeze()
    threadpool_limits(1)
    os.fsync = lambda descriptor: None  # files of tests need not outlive the machine


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
