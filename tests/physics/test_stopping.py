"""Runs that end by their target: honest estimates of the whole survey, though errors decide where they end."""

import numpy as np
import pytest

from surveysim import run
from surveysim.reduction.setup import prepare
from surveysim.results.so_far import estimate_so_far
from surveysim.results.stopping import FEWEST, best_estimate
from surveysim.runtime.engine import SERIAL
from surveysim.survey.run import run_observations
from tests.seeds import shared_expectations
from tests.stopped import WEATHER, weather_scene

SEEDS = 24
TARGET = 0.055
LONG = 1200  # observations of the reference


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    """sigma(A) of the scene's survey and its error, from a survey many times as long with more flips and skies."""
    settings = {
        "observations": LONG,
        "score.jackknives": 256,
        "score.signal_sims.skies": 24,
        "score.signal_sims.observations": 300,
    }
    setup = prepare(weather_scene(tmp_path_factory.mktemp("long"), settings))
    found = estimate_so_far(setup, run_observations(setup, None))
    scale = LONG / WEATHER["observations"]
    return scale * found.sigma_ukcmb2, scale * found.error_ukcmb2


@pytest.mark.slow
def test_stopped_runs_are_honest(tmp_path, reference):
    """24 seeds: the mean is that of a long run, deviations are as large as is said, and the target is kept."""
    found = []
    for seed in range(SEEDS):
        with shared_expectations():
            result = run(weather_scene(tmp_path, {"seed": 9000 + seed}), engine=SERIAL, target_error=TARGET)
        assert result.stopped == "target" and FEWEST <= result.coadds.done < 200
        assert result.estimate.relative_error <= TARGET and result.estimate.kind == "controlled"
        assert result.estimate == best_estimate(result.scores)
        found.append((result.estimate.sigma_ukcmb2, result.estimate.error_ukcmb2))
    sigma, error = np.array(found).T
    expected, expected_error = reference
    # The reference, whose error all share, is compared with the mean; the scatter with the stated errors.
    chi2 = np.sum(((sigma - sigma.mean()) / error) ** 2) / (SEEDS - 1)
    assert abs(chi2 - 1) < 3 * np.sqrt(2 / SEEDS), chi2
    mean_error = np.hypot(sigma.std(ddof=1) / np.sqrt(SEEDS), expected_error)
    assert sigma.mean() == pytest.approx(expected, abs=3 * mean_error)
    assert expected_error < 0.3 * np.median(error)
