"""Forecasts of destriped and maximum-likelihood maps against simulated surveys."""

import numpy as np
import pytest

from surveysim import run
from surveysim.results.agreement import forecast_agreement
from surveysim.runtime.engine import SERIAL
from tests.physics.test_forecast_validity import UNMASKED, Case

SHORT = {"observations": 8, "score.jackknives": 8, "score.noise_only_sets": [], "score.signal_sims.observations": 2}
CASES = {
    "maximum likelihood": {
        "cleaning.algorithm": "none",
        "map.maker": "maximum_likelihood",
        "map.maximum_likelihood.tolerance": 1e-3,
    },
    "maximum likelihood, readout noise": {
        "cleaning.algorithm": "none",
        "map.maker": "maximum_likelihood",
        "map.maximum_likelihood.tolerance": 1e-3,
        "readout_noise.detector": {"knee": "0.5 Hz", "slope": 1.5},
        "readout_noise.array": {"knee": "2 Hz", "slope": 2},
    },
    "destriped": {
        "cleaning.responsivities": "known",
        "map.maker": "destriped",
        "map.destriped.baseline": "3 s",
        "map.destriped.tolerance": 1e-3,
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_forecasts_of_solved_maps_are_right(tmp_path, name):
    """Within two errors in sigma(A), within 10 % in the mean noise PSD of all bins, and in the transfer function."""
    result = run(Case(SHORT | CASES[name], text=UNMASKED).scene(tmp_path / "scene.toml"), engine=SERIAL)
    found, expected = forecast_agreement(result)["actual"], result.expected.scores["actual"]
    assert not [effect.name for effect in expected.effects if effect.flagged]
    assert found.sigma_error < 0.09 and abs(found.sigma) < 2 * found.sigma_error
    edges = result.setup.analysis.region.rings.edges_ell
    bins = (edges[:-1] >= found.low_ell) & (edges[1:] <= found.high_ell)
    ratio = (expected.noise_psd / result.scores["actual"].noise_psd)[bins]
    assert len(ratio) == 9 and abs(np.mean(ratio) - 1) < 0.1
    passed = result.scores["actual"].transfer_function.transmission
    np.testing.assert_allclose(expected.transmission[bins], passed[bins], atol=0.08)
