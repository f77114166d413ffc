"""Noise of an observation whose weights are those of its time-streams."""

import numpy as np
import pytest

from surveysim import load_scene
from surveysim.reduction.map_noise import map_noise, probe_map, weighed_noise
from surveysim.reduction.setup import prepare
from tests.scenes import write_scene

WEIGHT, EXCESS, HITS = 0.25, 1.7, 40  # [1/mK^2] a sample; true variance over that of the weights


@pytest.fixture(scope="module")
def analysis(tmp_path_factory):
    return prepare(load_scene(write_scene(tmp_path_factory.mktemp("scene")))).analysis


@pytest.mark.parametrize("scored", [True, False])
def test_weights_and_true_noise_are_told_apart(analysis, scored):
    """White streams with weights w and the variance e / w: the right-hand side has the variance e w a sample."""
    region, geometry = analysis.region if scored else None, analysis.geometry
    shape, rng = (geometry.n_y, geometry.n_x), np.random.default_rng(3)
    hits, probe = np.full(shape, HITS), probe_map(geometry)
    noises, bins = [], []
    for _ in range(200):
        total = rng.normal(size=shape) * np.sqrt(EXCESS * WEIGHT * HITS)
        noise, of_bins = weighed_noise(region, total, hits, probe=probe, observed=WEIGHT * HITS * probe)
        noises.append(noise)
        bins.append(of_bins)
    np.testing.assert_allclose(noises, 1 / WEIGHT, rtol=1e-6)  # the same weight, whatever the noise
    if scored:
        mean, error = np.mean(bins, axis=0), np.std(bins, axis=0, ddof=1) / np.sqrt(len(bins))
        assert (np.abs(mean - EXCESS / WEIGHT) < 4 * error).all() and (error < 0.1 * mean).any()


def test_no_hit_has_infinite_noise(analysis):
    shape = (analysis.geometry.n_y, analysis.geometry.n_x)
    none = np.zeros(shape)
    noise, of_bins = weighed_noise(
        analysis.region, none, none.astype(int), probe=probe_map(analysis.geometry), observed=none
    )
    assert noise == np.inf and np.isinf(of_bins).all()
    assert map_noise(analysis.region, none, none)[0] == np.inf
