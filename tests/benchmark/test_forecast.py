"""A whole forecast, and its parts."""

import numpy as np
import pytest

from surveysim.forecasting.forecast import forecast
from surveysim.forecasting.mode_kernels import apodized_sums
from surveysim.reduction.setup import prepare
from surveysim.scene.scene import load_scene


@pytest.mark.parametrize("algorithm", ["average", "quadratic"])
def test_lynx(benchmark, pytestconfig, algorithm):
    """All data sets of 100 observations, the scene made ready before."""
    path = pytestconfig.rootpath / "scenarios" / "lynx.toml"
    scene = load_scene(path, {"observations": 100, "cleaning.algorithm": algorithm})
    benchmark.pedantic(forecast, args=(prepare(scene),), rounds=3, warmup_rounds=1)


def test_apodized_sums(benchmark):
    """The layer's wavevectors through the apodization of the modes of 25 bins."""
    rng = np.random.default_rng(1)
    strength, power, transfer = rng.random((1000, 512)), rng.random((3, 512)), rng.random(641)
    frequency, at, mean = rng.uniform(-4, 4, 512), rng.uniform(-3, 3, 1000), rng.random(512)
    losses = np.zeros(0), np.zeros((1000, 0)), np.zeros((0, 512)), np.zeros((0, 0))  # no fitted modes, no filters
    sums = (strength, power, frequency, at, transfer, 160.0, mean, np.zeros(512), *losses)
    benchmark.pedantic(apodized_sums, args=sums, rounds=10, warmup_rounds=1)
