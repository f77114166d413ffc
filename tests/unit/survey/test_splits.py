"""Split maps: they add up to the whole map, with the same bits however a survey is run."""

from dataclasses import replace

import h5py
import numpy as np
import pytest

from surveysim import load_scene
from surveysim.reduction.observation import observe
from surveysim.reduction.setup import prepare
from surveysim.reduction.splits import survey_splits
from surveysim.runtime.engine import Engine
from surveysim.runtime.errors import SceneError
from surveysim.survey.checkpoint import load_checkpoint, save_checkpoint
from surveysim.survey.coadd_tree import CoAddTree
from surveysim.survey.coadds import observation_sums, split_signs
from surveysim.survey.run import run_observations
from tests.scenes import SCHEDULE, SMALL_SCENE, SPECTRA, with_scan, without_sections, write_scene

ARRAYS = ("split_sums", "split_weight", "split_flipped")


@pytest.fixture(scope="module")
def setup(tmp_path_factory):
    # One scan a block, and lost samples.
    dropped = {"rate": "0.05 Hz", "length": "0.5 s", "shared": "detector"}
    keys = {"numerics.max_block_memory": "0.005 MB", "dropped_samples": dropped}
    keys |= {"spectra.splits": ["direction", "night", "array"], "spectra.realizations": 3}
    return prepare(load_scene(write_scene(tmp_path_factory.mktemp("scene"), SMALL_SCENE + SPECTRA), keys))


@pytest.fixture(scope="module")
def coadds(setup):
    return run_observations(setup, None)


def same(one, other):
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_parts_add_up_to_the_whole_map(setup, coadds):
    patch = setup.analysis.region.patch
    whole, weight = coadds.sums[0, patch, patch], coadds.weight[0, patch, patch]
    assert len(setup.observing.blocks) == 4
    for split in setup.analysis.splits.splits:
        maps = split.maps
        np.testing.assert_allclose(coadds.split_sums[maps].sum(axis=0), whole, atol=3e-7 * np.abs(whole).max())
        np.testing.assert_allclose(coadds.split_weight[maps].sum(axis=0), weight, atol=1e-12 * weight.max())
        assert all(item.any() for item in coadds.split_weight[maps])


def test_flipped_maps_are_sums_with_common_signs(setup, coadds):
    expected = np.zeros(coadds.split_flipped.shape)
    for number in range(4):
        item = observation_sums(setup.analysis, observe(setup, number, with_signal_sims=False))
        maps = np.stack([item.split_sums, item.split_weight], axis=1)
        expected += split_signs(setup.scene, number)[:, None, None, None] * maps[:, None]
    np.testing.assert_allclose(coadds.split_flipped, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_same_bits_on_workers_and_after_a_stop(tmp_path, setup, coadds):
    same(run_observations(setup, None, Engine("processes", workers=2)), coadds)
    tree = CoAddTree(setup)
    for number in (2, 0):
        tree.add(observation_sums(setup.analysis, observe(setup, number, with_signal_sims=number < 2)))
    tree.advance()
    save_checkpoint(tmp_path / "checkpoint.h5", tree.nodes(), setup)
    same(run_observations(setup, None, nodes=load_checkpoint(tmp_path / "checkpoint.h5", setup)), coadds)


def test_absent_section_changes_nothing(tmp_path, setup, coadds):
    without = prepare(setup.scene.model_copy(update={"spectra": None}))
    found = run_observations(without, None)
    np.testing.assert_array_equal(found.sums, coadds.sums)
    np.testing.assert_array_equal(found.flipped, coadds.flipped)
    save_checkpoint(tmp_path / "checkpoint.h5", [found], without)
    with h5py.File(tmp_path / "checkpoint.h5") as file:
        assert not any(name.startswith("split") for name in file["000000000"])
    assert load_checkpoint(tmp_path / "checkpoint.h5", without)[0].done == 4


def parts(scene, **of):
    found = survey_splits(scene, prepare(scene).camera.focal_plane, of.get("start_mjd"), of.get("block"))
    return found.night_parts.tolist()


def test_nights_are_dealt_out_in_turns_that_rotate(setup):
    scene = setup.scene.model_copy(update={"observations": 12})
    spectra = scene.spectra
    assert parts(scene) == [0, 1, 1, 0, 0, 1, 1, 0, 0, 1, 1, 0]
    three = scene.model_copy(update={"spectra": spectra.model_copy(update={"parts": 3})})
    assert parts(three) == [0, 1, 2, 1, 2, 0, 2, 0, 1, 0, 1, 2]


def test_nights_of_a_schedule(tmp_path):
    text = without_sections(SMALL_SCENE, "fixed_pointing") + SPECTRA + SCHEDULE
    scene = load_scene(write_scene(tmp_path, text), {"observations": 12, "schedule.nights": 4})
    splits = prepare(scene).analysis.splits
    assert splits.dated and splits.night.tolist() == np.repeat(range(4), 3).tolist()
    assert splits.night_parts.tolist() == np.repeat([0, 1, 1, 0], 3).tolist()
    # Weather that drifts for two nights: they are one.
    start = prepare(scene).observing.angles.start_mjd
    block = np.repeat([0, 1], 6)
    assert parts(scene, start_mjd=start, block=block) == np.repeat([0, 1], 6).tolist()


def test_halves_of_the_array_are_interleaved(setup):
    plane, half = setup.camera.focal_plane, setup.analysis.splits.half
    assert abs(np.sum(half == 0) - np.sum(half == 1)) <= 1
    for row in np.unique(np.round(plane.y_rad, 9)):
        own = np.flatnonzero(np.abs(plane.y_rad - row) < 1e-8)
        in_row = half[own[np.argsort(plane.x_rad[own])]]
        assert (np.diff(in_row) != 0).all()


@pytest.mark.parametrize(
    ("text", "keys", "message"),
    [
        (SMALL_SCENE, {"spectra.parts": 3}, "spectra.parts: found 3 with 4 observations; at most 2 parts are expected"),
        (SMALL_SCENE, {"observations": 2}, "found 2 with 2 observations; a longer survey is expected"),
        (SMALL_SCENE, {"spectra.parts": None}, "spectra.parts: missing; 'night' needs it"),
        (SMALL_SCENE, {"spectra.splits": ["array"]}, "spectra.parts: found without the split 'night'"),
        (SMALL_SCENE, {"spectra.splits": ["night", "night"]}, "found 'night' more than once"),
        (SMALL_SCENE, {"spectra.ell_bin": 9000}, "spectra.ell_bin: found 9000; 8000 or less"),
        (SMALL_SCENE, {"spectra.ell_bin": 10}, "spectra.ell_bin: found 10; 900 or more is expected, the distance"),
        (SMALL_SCENE, {"scan.scans": 1}, "found 'direction' with one scan of the pattern 'raster'"),
        (SMALL_SCENE, {"map.maker": "maximum_likelihood"}, "spectra: found with map.maker = 'maximum_likelihood'"),
        (SMALL_SCENE, {"score": None}, r"spectra: found without \[score\]"),
        (
            with_scan(
                SMALL_SCENE,
                'pattern = "daisy"\nradius = "5 arcmin"\nradial_period = "10 s"\nduration = "60 s"\nchunk = "6 s"\n'
                'dither = "0 arcmin"\nsample_rate = "10 Hz"',
            ),
            {},
            "found 'direction' with the pattern 'daisy'; scans there and back",
        ),
    ],
)
def test_refusals(tmp_path, text, keys, message):
    with pytest.raises(SceneError, match=message) as caught:
        prepare(load_scene(write_scene(tmp_path, text + SPECTRA), keys))
    assert "\n" not in str(caught.value)


def test_weights_of_detectors_hold_in_parts(setup):
    """Of unlike detectors: the halves add up with the weights that the whole map has."""
    weight = np.linspace(0.5, 1.5, setup.camera.n_det)
    unlike = replace(setup, analysis=replace(setup.analysis, weight=weight))
    found = observe(unlike, 0, with_signal_sims=False)
    patch = setup.analysis.region.patch
    assert not np.allclose(found.exposure[0], found.hits[0])
    for own in (slice(0, 2), slice(2, 4)):
        np.testing.assert_allclose(
            found.split_exposure[own].sum(axis=0), found.exposure[0, patch, patch], rtol=1e-5, atol=1e-9
        )
