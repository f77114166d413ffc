"""Checkpoints: whole, atomic, of this scene and version, or refused."""

import errno
import json
import re
import resource
from hashlib import sha256
from io import BytesIO

import h5py
import numpy as np
import pytest

from surveysim import load_scene
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import Engine, EngineError
from surveysim.scene.scene import survey_hash
from surveysim.survey.checkpoint import _MARK, CheckpointError, check_streams, load_checkpoint, save_checkpoint
from surveysim.survey.remote_node import SUMS_OF_SPANS
from surveysim.survey.run import SpanJob, finished_sums, run_observations
from surveysim.survey.spans import Span
from tests.scenes import SCHEDULE, SMALL_SCENE, without_sections, write_scene

NODE = "000000000"
ARRAYS = ("sums", "weight", "hits", "flipped", "signal_maps", "signal_weight")


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return load_scene(write_scene(tmp_path_factory.mktemp("scene")))


@pytest.fixture(scope="module")
def setup(scene):
    return prepare(scene)


@pytest.fixture(scope="module")
def coadds(setup):
    return run_observations(setup, None)


@pytest.fixture
def path(tmp_path, coadds, setup):
    path = tmp_path / "checkpoint.h5"
    save_checkpoint(path, [coadds], setup)
    return path


def same(one, other):
    for name in ARRAYS:
        left, right = getattr(one, name), getattr(other, name)
        assert left.dtype == right.dtype
        np.testing.assert_array_equal(left, right)
    for name in ("rows", "raw_psd", "clean_psd"):
        np.testing.assert_array_equal(np.array(getattr(one, name)), np.array(getattr(other, name)))
    return True


def test_round_trip(path, coadds, setup):
    (loaded,) = load_checkpoint(path, setup)
    assert same(loaded, coadds) and loaded.seconds == coadds.seconds and loaded.done == 4
    assert [item.name for item in path.parent.iterdir()] == [path.name]


def test_round_trip_of_nothing(tmp_path, setup):
    save_checkpoint(tmp_path / "new" / "checkpoint.h5", [], setup)
    assert load_checkpoint(tmp_path / "new" / "checkpoint.h5", setup) == []


@pytest.fixture
def refused(path, setup):
    def refused(words="damaged, or not a checkpoint; delete it and go on with --resume"):
        with pytest.raises(CheckpointError, match=words) as caught:
            load_checkpoint(path, setup)
        text = str(caught.value)
        assert text.startswith(f"{path}: ") and text.isprintable() and len(text) < len(str(path)) + 250

    return refused


def test_every_truncation_is_refused(path, refused):
    raw = path.read_bytes()
    for share in np.linspace(0, 0.999, 23):
        path.write_bytes(raw[: int(share * len(raw))])
        refused()


def test_every_flipped_bit_is_refused(path, refused):
    """Of the sums and of the file's own structure alike; what fills the first block up carries nothing."""
    raw = path.read_bytes()
    places = np.linspace(512, len(raw) - 1, 60).astype(int)
    for place in (0, 57, 58, 121, *places):
        damaged = bytearray(raw)
        damaged[place] ^= 0x04
        path.write_bytes(damaged)
        refused()


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04", bytes(1000)])
def test_other_files_are_refused(path, refused, content):
    path.write_bytes(content)
    refused()


def test_other_hdf5_files_are_refused(path, refused):
    with h5py.File(path, "w") as file:
        file["sums"] = np.zeros(3)
    refused()


def test_another_scene_or_version(path, coadds, setup, monkeypatch):
    with monkeypatch.context() as other:
        other.setattr("surveysim.survey.checkpoint.__version__", "0.0.1")
        with pytest.raises(CheckpointError, match="from another version"):
            load_checkpoint(path, setup)
    other = prepare(setup.scene.model_copy(update={"seed": 99}))
    with pytest.raises(
        CheckpointError, match="from another scene .*start anew with --force, or write elsewhere with --out"
    ):
        load_checkpoint(path, other)


def changed(name, change):
    """An array of the file, changed."""

    def apply(file):
        value = change(file[NODE][name][()])
        del file[NODE][name]
        file[NODE][name] = value

    return apply


def set_at(value, place=0):
    def change(array):
        array.flat[place] = value
        return array

    return change


def meta(**others):
    def apply(file):
        file.attrs["meta"] = json.dumps(json.loads(file.attrs["meta"]) | others)

    return apply


def seconds(text):
    def apply(file):
        file[NODE].attrs["seconds"] = text

    return apply


def all_of(*changes):
    def apply(file):
        for change in changes:
            change(file)

    return apply


LISTS = ("rows", "raw_psd", "clean_psd", "compared_psd")
FORGERIES = {
    **{f"shape of {name}": changed(name, lambda array: array[..., :-1]) for name in (*ARRAYS, *LISTS)},
    **{f"dimensions of {name}": changed(name, lambda array: array[None]) for name in ("sums", "rows", "raw_psd")},
    **{
        f"NaN in {name}": changed(name, set_at(np.nan))
        for name in ("sums", "weight", "flipped", "signal_maps", "raw_psd")
    },
    **{f"infinity in {name}": changed(name, set_at(np.inf)) for name in ("sums", "signal_weight", "clean_psd")},
    **{f"vast {name}": changed(name, set_at(-2e30)) for name in ("sums", "flipped", "signal_maps")},
    "infinite noise of an observation with data": changed("bin_noise", set_at(np.inf, 3)),
    "no noise of an observation with data": changed("rows", set_at(np.inf, -1)),
    "unknown noise": changed("rows", set_at(np.nan, -1)),
    **{f"negative {name}": changed(name, set_at(-1)) for name in ("hits", "weight", "signal_weight", "raw_psd")},
    **{f"no {name}": (lambda file, name=name: file[NODE].pop(name)) for name in (*ARRAYS, *LISTS)},
    "another name": lambda file: file[NODE].move("sums", "sum"),
    "one name more": lambda file: file[NODE].create_dataset("more", data=1.0),
    "a group": all_of(lambda file: file[NODE].pop("hits"), lambda file: file[NODE].create_group("hits")),
    "a link to another file": all_of(
        lambda file: file[NODE].pop("hits"),
        lambda file: file[NODE].update({"hits": h5py.ExternalLink("other.h5", "hits")}),
    ),
    "single precision": changed("sums", lambda array: array.astype(np.float32)),
    "hits as floats": changed("hits", lambda array: array.astype(float)),
    "hits of 32 bits": changed("hits", lambda array: array.astype(np.int32)),
    "text": changed("rows", lambda array: np.full(array.shape, b"text")),
    "complex": changed("raw_psd", lambda array: array.astype(complex)),
    "fewer rows": changed("rows", lambda array: array[:-1]),
    "rows of more observations": all_of(*(changed(name, lambda array: np.repeat(array, 2, 0)) for name in LISTS)),
    "rows in another order": changed("rows", lambda array: array[::-1]),
    "a row twice": changed("rows", lambda array: array[[0, 0, 2, 3]]),
    "sums without hits": changed("hits", np.zeros_like),
    "sums without weight": changed("weight", np.zeros_like),
    "meta of text": lambda file: file.attrs.update(meta="text"),
    "meta of a list": lambda file: file.attrs.update(meta="[]"),
    "meta of numbers": lambda file: file.attrs.update(meta=3),
    "no meta": lambda file: file.attrs.pop("meta"),
    "no seconds": lambda file: file[NODE].attrs.pop("seconds"),
    "seconds that are no object": seconds("[]"),
    "negative seconds": seconds('{"cleaning": -1.0}'),
    "seconds of text": seconds('{"cleaning": "1"}'),
    "infinite seconds": seconds('{"cleaning": Infinity}'),
    "a node twice": lambda file: file.copy(NODE, "000000001"),
    "a dataset in place of a node": lambda file: file.create_dataset("000000004", data=1.0),
    "half a node": all_of(*(changed(name, lambda array: array[1:]) for name in (*LISTS, "bin_noise"))),
    "no observation": all_of(*(changed(name, lambda array: array[:0]) for name in (*LISTS, "bin_noise"))),
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_contents_of_no_run_are_refused(path, refused, forgery):
    """With a digest that is right."""
    forge(path, FORGERIES[forgery])
    refused(r"not what a run of this scene writes \(.+\); delete it and go on with --resume")


@pytest.mark.parametrize("key", ["version", "scene"])
@pytest.mark.parametrize("value", [None, 3, "", "other", ["other"], "\x1b[31m" * 9])
def test_other_origins_are_refused(path, refused, key, value):
    forge(path, meta(**{key: value}))
    refused(f"from another {key} .found .*; start anew with --force, or write elsewhere with --out")


def forge(path, change):
    """Change a checkpoint and sign it anew."""
    content = BytesIO(path.read_bytes())
    with h5py.File(content, "r") as old, h5py.File(whole := BytesIO(), "w", userblock_size=512) as new:
        new.attrs.update(old.attrs)
        for name in old:
            old.copy(name, new)
        change(new)
    rest = whole.getvalue()[512:]
    path.write_bytes((_MARK + sha256(rest).hexdigest().encode()).ljust(512, b"\0") + rest)


def test_what_is_no_hdf5_is_refused(path, refused):
    path.write_bytes((_MARK + sha256(b"text").hexdigest().encode()).ljust(512, b"\0") + b"text")
    refused("not what a run of this scene writes")


def test_sizes_are_compared_before_anything_is_read(path, refused):
    """A few bytes can claim to be terabytes."""

    def claim(file):
        file[NODE].pop("sums")
        file[NODE].create_dataset("sums", (1 << 40,), float, chunks=(1 << 20,), compression="gzip")

    forge(path, claim)
    refused("sums has the shape")


def test_streams_of_another_run_are_refused(tmp_path, scene, setup):
    """A resumed run lists only its own files."""
    path, streams = tmp_path / "checkpoint.h5", tmp_path / "timestreams"
    run_observations(setup, path, timestream_dir=streams, stops=lambda so_far: so_far.done == 2)
    for number in (2, 3):  # of no observation that is kept
        (streams / f"{number:04d}.h5").write_text("of nobody")
    nodes = load_checkpoint(path, setup)
    check_streams(streams, setup, nodes)
    (streams / "0000.h5").unlink()  # of before a resumption that asked for them
    check_streams(streams, setup, nodes)
    whole = (streams / "0001.h5").read_bytes()
    with h5py.File(streams / "0001.h5", "r+") as file:
        file.attrs["survey_sha256"] = "0" * 64
    other = (streams / "0001.h5").read_bytes()
    for content in (b"", b"text", whole[:2000], other):
        (streams / "0001.h5").write_bytes(content)
        with pytest.raises(
            CheckpointError, match="0001.h5: not the time-streams of observation 1 of this scene; start anew"
        ):
            finished_sums(setup, path, streams)
    (streams / "0000.h5").write_bytes(whole)
    with pytest.raises(CheckpointError, match="0000.h5: not the time-streams of observation 0"):
        check_streams(streams, setup, nodes)


def test_full_disk_leaves_the_old_one(path, coadds, setup):
    """A write that fails: at once, in the middle, or with the last byte."""
    before = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    for share in (0.0, 0.5, 1.0):
        resource.setrlimit(resource.RLIMIT_FSIZE, (max(0, int(share * len(before)) - 1), limits[1]))
        try:
            with pytest.raises(OSError) as caught:
                save_checkpoint(path, [coadds], setup)
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
    assert [node.done for node in load_checkpoint(path, setup)] == [3]
    assert same(run_observations(setup, path, nodes=finished_sums(setup, path)), coadds)


def test_a_finished_checkpoint_has_nothing_left_to_do(tmp_path, scene, coadds):
    path = tmp_path / "checkpoint.h5"
    save_checkpoint(path, [coadds], prepare(scene))
    setup = prepare(scene)
    assert same(run_observations(setup, path, Engine(workers=2), nodes=finished_sums(setup, path)), coadds)


def test_without_resume_a_checkpoint_is_not_read(tmp_path, scene, coadds):
    path = tmp_path / "checkpoint.h5"
    path.write_text("damaged")
    assert same(run_observations(prepare(scene), path), coadds)


def test_other_tools_read_it(path, coadds, scene):
    with h5py.File(path) as file:
        assert json.loads(file.attrs["meta"])["scene"] == survey_hash(scene)
        np.testing.assert_array_equal(file[NODE]["hits"][()], coadds.hits)


def test_more_observations_are_added_to_a_finished_run(tmp_path, scene, setup, path):
    """The bits are those of a longer run from the start, and what is finished is not done again."""
    longer = prepare(scene.model_copy(update={"observations": 19}))
    seen = []
    nodes = finished_sums(longer, path)
    found = run_observations(longer, path, nodes=nodes, keep=True, progress=lambda sums: seen.append(sums.done))
    assert seen == list(range(5, 20)) and same(found, run_observations(longer, None))
    assert [node.done for node in load_checkpoint(path, longer)] == [16, 3]
    with pytest.raises(CheckpointError, match="has observations up to number 18, found observations = 4; 19 or more"):
        load_checkpoint(path, setup)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["processes", pytest.param("dask", marks=pytest.mark.slow)])
def test_sums_of_many_observations_travel_as_nodes(scene, kind):
    """Workers add up whole leaves, and the bits are those of one process."""
    setup = prepare(scene.model_copy(update={"observations": 240}))
    counts = []
    found = run_observations(setup, None, Engine(kind, workers=2), progress=lambda sums: counts.append(sums.done))
    assert same(found, run_observations(setup, None)) and len(counts) < 200 and counts[-1] == 240


@pytest.mark.slow
def test_sums_on_a_cluster_are_in_its_checkpoints(tmp_path, scene):
    setup, path, kept = prepare(scene.model_copy(update={"observations": 240})), tmp_path / "checkpoint.h5", []

    def stop(sums):
        kept[:] = [sums.finished]
        if sums.done > 150:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_observations(setup, path, Engine("dask", workers=2), progress=stop)
    nodes = load_checkpoint(path, setup)
    assert sum(node.done for node in nodes) == kept[0] and max(node.done for node in nodes) >= 32
    assert same(run_observations(setup, path, nodes=nodes), run_observations(setup, None))


class HeldSums:
    """Sums on a cluster, for as long as it is there."""

    def __init__(self, sums, gone):
        self.sums, self.gone, self.outline = sums, gone, SUMS_OF_SPANS.outline(sums)

    def fetch(self):
        if self.gone:
            raise EngineError("the scheduler is gone")
        return self.sums

    def joined(self, other):
        return HeldSums(SUMS_OF_SPANS.join(self.sums, other.sums), self.gone)


def test_a_cluster_that_is_gone_leaves_the_last_checkpoint(tmp_path, scene, monkeypatch):
    """The sums of the first 16 observations are saved; later they are joined with others that are lost."""
    setup, path, gone = prepare(scene.model_copy(update={"observations": 48})), tmp_path / "checkpoint.h5", []
    first, second = (SpanJob(setup.scene, None)(Span(number, number + 16)) for number in (0, 16))

    def lost(job, spans, engine, large, meanwhile):
        with monkeypatch.context() as patch:
            patch.setattr("surveysim.survey.run.monotonic", lambda: np.inf)  # a checkpoint is due
            yield 0, HeldSums(first, gone)
        yield 16, HeldSums(second, gone)
        gone.append(True)
        raise EngineError("the scheduler is gone")

    monkeypatch.setattr("surveysim.survey.run.unordered_map", lost)
    with pytest.raises(EngineError, match="the scheduler is gone"):
        run_observations(setup, path, Engine("processes", workers=2))
    (node,) = load_checkpoint(path, setup)
    assert (node.first, node.done) == (0, 16) and same(node, first)


@pytest.mark.parametrize(
    "observations, nights, words",
    [
        (
            8,
            2,
            "observations = 8 with schedule.nights = 2 moves finished observations to other times; schedule.nights = 4",
        ),
        (7, 2, "both in the proportion of the finished run, 4 observations in 2 nights, keep them"),
    ],
)
def test_more_observations_at_other_times_name_the_nights_that_keep_them(tmp_path, observations, nights, words):
    """The number named is accepted."""
    scene = tmp_path / "scene.toml"
    scene.write_text(without_sections(SMALL_SCENE, "fixed_pointing") + SCHEDULE)
    small = prepare(load_scene(scene, {"observations": 4, "schedule.nights": 2}))
    path = tmp_path / "checkpoint.h5"
    save_checkpoint(path, [run_observations(small, None)], small)
    with pytest.raises(CheckpointError, match=re.escape(words)):
        load_checkpoint(path, prepare(load_scene(scene, {"observations": observations, "schedule.nights": nights})))
    (kept,) = load_checkpoint(path, prepare(load_scene(scene, {"observations": 8, "schedule.nights": 4})))
    assert kept.done == 4
