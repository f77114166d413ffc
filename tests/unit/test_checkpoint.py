"""Checkpoints: whole, atomic, of this scene and version, or refused."""

import errno
import json
import resource

import h5py
import numpy as np
import pytest

from surveysim import load_scene
from surveysim.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from surveysim.coadds import empty_coadds
from surveysim.engines import Engine
from surveysim.scene import scene_hash
from surveysim.setup import prepare
from surveysim.survey import run_observations
from tests.scenes import SMALL_SCENE

ARRAYS = ("sums", "weight", "hits", "flipped", "window", "window_weight")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "small.toml"
    path.write_text(SMALL_SCENE)
    return load_scene(path)


@pytest.fixture(scope="module")
def coadds(scene):
    return run_observations(prepare(scene), None)


@pytest.fixture
def path(tmp_path, coadds):
    path = tmp_path / "checkpoint.h5"
    save_checkpoint(path, coadds, "abc")
    return path


def same(one, other):
    for name in ARRAYS:
        left, right = getattr(one, name), getattr(other, name)
        assert left.dtype == right.dtype
        np.testing.assert_array_equal(left, right)
    for name in ("rows", "raw_psd", "clean_psd"):
        np.testing.assert_array_equal(np.array(getattr(one, name)), np.array(getattr(other, name)))
    return True


def test_round_trip(path, coadds):
    loaded = load_checkpoint(path, "abc")
    assert same(loaded, coadds) and loaded.seconds == coadds.seconds and loaded.done == 4
    assert [item.name for item in path.parent.iterdir()] == [path.name]


def test_round_trip_of_nothing(tmp_path, scene):
    empty = empty_coadds(prepare(scene))
    save_checkpoint(tmp_path / "new" / "checkpoint.h5", empty, "abc")
    assert same(load_checkpoint(tmp_path / "new" / "checkpoint.h5", "abc"), empty)


def refused(path, words="damaged, or no checkpoint at all; delete it and go on with --resume"):
    with pytest.raises(CheckpointError, match=words) as caught:
        load_checkpoint(path, "abc")
    assert str(caught.value).startswith(f"{path}: ") and len(str(caught.value).splitlines()) == 1


def test_every_truncation_is_refused(path):
    raw = path.read_bytes()
    for share in np.linspace(0, 0.999, 23):
        path.write_bytes(raw[: int(share * len(raw))])
        refused(path)


def test_every_flipped_bit_is_refused(path):
    """Of the sums and of the file's own structure alike; what fills the first block up carries nothing."""
    raw = path.read_bytes()
    places = np.linspace(512, len(raw) - 1, 60).astype(int)
    for place in (0, 57, 58, 121, *places):
        damaged = bytearray(raw)
        damaged[place] ^= 0x04
        path.write_bytes(damaged)
        refused(path)


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04", bytes(1000)])
def test_other_files_are_refused(path, content):
    path.write_bytes(content)
    refused(path)


def test_other_hdf5_files_are_refused(path):
    with h5py.File(path, "w") as file:
        file["sums"] = np.zeros(3)
    refused(path)


def test_another_scene_or_version(path, monkeypatch):
    with pytest.raises(CheckpointError, match="of another scene .*without --resume, or with --out elsewhere"):
        load_checkpoint(path, "abd")
    monkeypatch.setattr("surveysim.checkpoint.__version__", "0.0.1")
    with pytest.raises(CheckpointError, match="of another version"):
        load_checkpoint(path, "abc")


def test_full_disk_leaves_the_old_one(path, coadds):
    """A write that fails: at once, in the middle, or with the last byte."""
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    for share in (0.0, 0.5, 1.0):
        resource.setrlimit(resource.RLIMIT_FSIZE, (max(0, int(share * len(before)) - 1), limits[1]))
        try:
            with pytest.raises(OSError) as caught:
                save_checkpoint(path, coadds, "abc")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert caught.value.errno == errno.EFBIG and caught.value.filename == str(path)
        assert path.read_bytes() == before and [item.name for item in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_stopped_runs_keep_what_is_done(tmp_path, scene, coadds, error):
    """The checkpoint holds the observations that were in, and resuming gives the same bits."""
    setup, path = prepare(scene), tmp_path / "checkpoint.h5"

    def stop(so_far):
        if so_far.done == 3:
            raise error

    with pytest.raises(error):
        run_observations(setup, path, progress=stop)
    assert load_checkpoint(path, scene_hash(scene)).done == 3
    assert same(run_observations(setup, path, resume=True), coadds)


def test_a_finished_checkpoint_has_nothing_left_to_do(tmp_path, scene, coadds):
    path = tmp_path / "checkpoint.h5"
    save_checkpoint(path, coadds, scene_hash(scene))
    assert same(run_observations(prepare(scene), path, engine=Engine(workers=2), resume=True), coadds)


def test_without_resume_a_checkpoint_is_not_read(tmp_path, scene, coadds):
    path = tmp_path / "checkpoint.h5"
    path.write_text("damaged")
    assert same(run_observations(prepare(scene), path), coadds)


def test_other_tools_read_it(path, coadds):
    with h5py.File(path) as file:
        assert json.loads(file.attrs["meta"])["scene"] == "abc"
        np.testing.assert_array_equal(file["hits"][()], coadds.hits)
