"""Arrays of other shapes than a scene's are refused before loops that test no index take them."""

from types import SimpleNamespace

import numpy as np
import pytest

from surveysim import load_scene
from surveysim.reduction.setup import prepare
from surveysim.survey.coadds import add_sums, empty_coadds, observation_sums
from surveysim.timestreams.simulation import observation_path
from surveysim.timestreams.sky import add_seen_sky
from tests.scenes import write_scene


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    path = write_scene(tmp_path_factory.mktemp("scene"))
    return prepare(load_scene(path))


@pytest.mark.parametrize("name", ["sums", "hits", "exposure", "noise_mk2"])
@pytest.mark.parametrize("cut", [np.s_[:-1], np.s_[None], np.s_[..., :-1]])
def test_results_of_another_shape(setup, name, cut):
    coadds = empty_coadds(setup.analysis)
    arrays = {
        "sums": np.ones(coadds.sums.shape),
        "hits": np.ones(coadds.hits.shape, int),
        "exposure": np.ones(coadds.hits.shape),
        "noise_mk2": np.ones(coadds.n_set),
    }
    with pytest.raises(ValueError, match=rf"{name}: found the shape .* is expected"):
        observation_sums(setup.analysis, SimpleNamespace(observation=0, **(arrays | {name: arrays[name][cut]})))


@pytest.mark.parametrize("cut", [np.s_[:-1], np.s_[:, :-1], np.s_[..., :-1], np.s_[:0]])
def test_sums_of_another_shape(setup, cut):
    coadds, later = empty_coadds(setup.analysis), empty_coadds(setup.analysis)
    later.flipped = later.flipped[cut]
    with pytest.raises(ValueError, match="is the next in order"):
        add_sums(coadds, later)


def test_skies_on_streams_of_another_shape(setup):
    _, pointing = observation_path(setup.observing, 0)
    shape, gain = (setup.camera.n_det, len(pointing.xi_rad)), np.ones(setup.camera.n_det)
    sky = np.ones((setup.sky.geometry.n_y, setup.sky.geometry.n_x), np.float32)
    right = np.zeros(shape, np.float32)
    add_seen_sky(setup, pointing, sky, right, gain)
    assert right.any()
    for wrong in (np.zeros((shape[0], shape[1] + 1)), np.zeros((shape[0] + 1, shape[1]))):
        with pytest.raises(ValueError, match="found streams .* are expected"):
            add_seen_sky(setup, pointing, sky, wrong, gain)
    with pytest.raises(ValueError, match="gains"):
        add_seen_sky(setup, pointing, sky, right, gain[:-1])
