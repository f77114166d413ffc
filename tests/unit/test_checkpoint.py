"""Checkpoints: whole, atomic, of this scene and version, or refused."""

import errno
import json

import numpy as np
import pytest

from surveysim import load_scene
from surveysim.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from surveysim.coadds import empty_coadds
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
    path = tmp_path / "checkpoint.npz"
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
    save_checkpoint(tmp_path / "new" / "checkpoint.npz", empty, "abc")
    assert same(load_checkpoint(tmp_path / "new" / "checkpoint.npz", "abc"), empty)


def test_every_truncation_is_refused(path):
    raw = path.read_bytes()
    for share in np.linspace(0, 0.999, 23):
        path.write_bytes(raw[: int(share * len(raw))])
        with pytest.raises(CheckpointError, match="damaged .*; delete it and run without --resume") as caught:
            load_checkpoint(path, "abc")
        assert str(path) in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_flipped_bits_are_refused_or_harmless(path, coadds):
    """The archive's checksums cover the content; its own dates and padding carry nothing."""
    raw = path.read_bytes()
    refused = 0
    for place in np.linspace(0, len(raw) - 1, 60).astype(int):
        damaged = bytearray(raw)
        damaged[place] ^= 0x04
        path.write_bytes(damaged)
        try:
            assert same(load_checkpoint(path, "abc"), coadds)
        except CheckpointError:
            refused += 1
    assert refused > 40


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04", bytes(1000)])
def test_other_files_are_refused(path, content):
    path.write_bytes(content)
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(path, "abc")


@pytest.mark.parametrize("meta", ["{}", "[]", "1", '{"scene": "abc"}', "not json"])
def test_archives_without_the_right_meta_are_refused(path, meta):
    with np.load(path) as file:
        arrays = dict(file)
    np.savez(path, **(arrays | {"meta": meta}))
    with pytest.raises(CheckpointError, match="damaged"):
        load_checkpoint(path, "abc")


def test_another_scene_or_version(path, monkeypatch):
    with pytest.raises(CheckpointError, match="of another scene .*without --resume, or with --out elsewhere"):
        load_checkpoint(path, "abd")
    monkeypatch.setattr("surveysim.checkpoint.__version__", "0.0.1")
    with pytest.raises(CheckpointError, match="of another version"):
        load_checkpoint(path, "abc")


def test_full_disk_leaves_the_old_one(path, coadds, monkeypatch):
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="No space left"):
        save_checkpoint(path, coadds, "abc")
    assert path.read_bytes() == before and [item.name for item in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("error", [KeyboardInterrupt, RuntimeError])
def test_stopped_runs_keep_what_is_done(tmp_path, scene, coadds, error):
    """The checkpoint holds the observations that were in, and resuming gives the same bits."""
    setup, path = prepare(scene), tmp_path / "checkpoint.npz"

    def stop(so_far):
        if so_far.done == 3:
            raise error

    with pytest.raises(error):
        run_observations(setup, path, progress=stop)
    assert load_checkpoint(path, scene_hash(scene)).done == 3
    assert same(run_observations(setup, path, resume=True), coadds)


def test_a_finished_checkpoint_has_nothing_left_to_do(tmp_path, scene, coadds):
    path = tmp_path / "checkpoint.npz"
    save_checkpoint(path, coadds, scene_hash(scene))
    assert same(run_observations(prepare(scene), path, workers=2, resume=True), coadds)


def test_without_resume_a_checkpoint_is_not_read(tmp_path, scene, coadds):
    path = tmp_path / "checkpoint.npz"
    path.write_text("damaged")
    assert same(run_observations(prepare(scene), path), coadds)


def test_meta_is_readable(path):
    with np.load(path) as file:
        assert json.loads(str(file["meta"]))["scene"] == "abc"
