"""Files of finished sweep points: whole and of this sweep, or refused in one line."""

import io
import json
import os

import numpy as np
import pytest

from surveysim import load_sweep
from surveysim.runtime.engine import SERIAL
from surveysim.studies.sweep.comparison import run_points
from surveysim.studies.sweep.point_store import load_point
from surveysim.survey.checkpoint import CheckpointError
from tests.scenes import SMALL_SCENE


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A sweep of one point and the file that it leaves."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "small.toml").write_text(SMALL_SCENE + '\n[sweep]\n"photon.psd" = ["2.5 mK2 / Hz"]\n')
    sweep = load_sweep(folder / "small.toml")
    run_points(sweep, folder / "points", SERIAL, False, lambda done: None)
    return sweep.points[0], (folder / "points" / "000.npz").read_bytes()


def content_of(raw):
    with np.load(io.BytesIO(raw)) as file:
        return dict(file)


def test_round_trip(finished, tmp_path):
    point, raw = finished
    (tmp_path / "000.npz").write_bytes(raw)
    result = load_point(tmp_path / "000.npz", point, 4)
    assert set(result.scores) >= {"actual", "uncorrelated", "white"} and result.unscored == ""
    assert not np.isnan(result.scores["actual"].band.sigma_ukcmb2)


def test_blocks_of_observations_come_back(finished, tmp_path):
    point, raw = finished
    np.savez(tmp_path / "000.npz", **meta(*SETS, "block", value=[0, 0, 1, 1])(content_of(raw)))
    result = load_point(tmp_path / "000.npz", point, 4)
    assert result.scores["actual"].block.tolist() == [0, 0, 1, 1]
    assert result.scores["white"].block is None


def meta(*keys, value):
    """Change what the file says at some keys; `del` takes the last one away."""

    def change(content):
        whole = json.loads(str(content["meta"]))
        place = whole
        for key in keys[:-1]:
            place = place[key]
        if value is del_:
            del place[keys[-1]]
        else:
            place[keys[-1]] = value
        return content | {"meta": json.dumps(whole)}

    return change


def array(name, change):
    return lambda content: content | {name: change(content[name])}


def at_first(value):
    return lambda array: np.concatenate([np.full(1, value), array.ravel()[1:]]).reshape(array.shape)


def set_all(value):
    return lambda array: np.full_like(array, value)


del_ = object()
SETS = ("sets", "actual")
ARRAYS = ("noise_psds", "signal_psd", "weights", "band.weight", "band.ell", "transfer_function.transmission")
NOT_NEGATIVE = ("noise_psds", "signal_psd", "weights", "band.weight", "control.weights", "plain.weight")
FORGERIES = {
    **{f"shape of {name}": array(f"actual/{name}", lambda a: a[..., :-1]) for name in ARRAYS},
    **{f"dimensions of {name}": array(f"actual/{name}", lambda a: a[None]) for name in ARRAYS},
    **{f"type of {name}": array(f"actual/{name}", lambda a: a.astype(np.int16)) for name in ARRAYS},
    **{f"text in {name}": array(f"actual/{name}", lambda a: a.astype(str)) for name in ARRAYS},
    **{f"NaN in {name}": array(f"actual/{name}", at_first(np.nan)) for name in ("noise_psds", "signal_psd", "weights")},
    **{f"negative {name}": array(f"actual/{name}", at_first(-1.0)) for name in NOT_NEGATIVE},
    **{f"infinite {name}": array(f"actual/{name}", at_first(np.inf)) for name in NOT_NEGATIVE},
    **{f"no noise of {name}": array(f"actual/{name}", set_all(np.inf)) for name in ("bin_noise", "control.noise")},
    **{f"NaN in {name}": array(f"actual/{name}", set_all(np.nan)) for name in ("bin_noise", "control.noise")},
    "an array less": lambda content: {k: v for k, v in content.items() if k != "actual/weights"},
    "an array more": lambda content: content | {"actual/more": np.zeros(3)},
    "no meta": lambda content: {k: v for k, v in content.items() if k != "meta"},
    "meta of text": lambda content: content | {"meta": "text"},
    "meta of a list": lambda content: content | {"meta": "[]"},
    "meta of numbers": lambda content: content | {"meta": np.arange(3)},
    "pickled meta": lambda content: content | {"meta": np.array({"scene": 1}, dtype=object)},
    "sets of a list": meta("sets", value=[]),
    "a set that is none of the scene's": lambda content: (
        {key.replace("white/", "../white/"): value for key, value in content.items()}
        | {"meta": str(content["meta"]).replace('"white": {', '"../white": {')}
    ),
    "no actual data": lambda content: (
        {key: value for key, value in content.items() if not key.startswith("actual/")}
        | meta(*SETS, value=del_)(content)
    ),
    "a number as text": meta(*SETS, "band", "sigma_ukcmb2", value="100"),
    "no sigma": meta(*SETS, "band", "sigma_ukcmb2", value=None),
    "infinite sigma": meta(*SETS, "band", "sigma_ukcmb2", value=float("inf")),
    "negative sigma": meta(*SETS, "band", "sigma_ukcmb2", value=-1.0),
    "a key less": meta(*SETS, "budget", "noise", value=del_),
    "a key more": meta(*SETS, "budget", "more", value=1.0),
    "blocks of fewer observations": meta(*SETS, "block", value=[0, 0, 1]),
    "blocks out of order": meta(*SETS, "block", value=[0, 1, 0, 1]),
    "a block without observations": meta(*SETS, "block", value=[0, 0, 2, 2]),
    "detectors of another camera": meta("rest", "n_det", value=5),
    "more detectors than there are": meta(*SETS, "n_det", value=500),
    "no time": meta("rest", "wall_s", value=float("nan")),
    "a share above 1": meta("rest", "discarded", value={"actual": 1.5}),
    "flags that are no texts": meta("rest", "flags", value=[1]),
    "a score and a reason for none": meta("rest", "unscored", value="too few"),
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_contents_of_no_point_are_refused(finished, tmp_path, forgery):
    point, raw = finished
    path = tmp_path / "000.npz"
    np.savez(path, **FORGERIES[forgery](content_of(raw)))
    refused(path, point, r"damaged \(.+\); delete it and go on with --resume")


@pytest.mark.parametrize("key", ["version", "scene"])
@pytest.mark.parametrize("value", [None, 3, "other", {"a": 1}])
def test_other_origins_are_refused(finished, tmp_path, key, value):
    point, raw = finished
    np.savez(tmp_path / "000.npz", **meta(key, value=value)(content_of(raw)))
    refused(tmp_path / "000.npz", point, f"from another {key} .found .*; start anew with --force")


def test_compressed_files_are_refused_unread(finished, tmp_path, monkeypatch):
    point, raw = finished
    np.savez_compressed(tmp_path / "000.npz", **content_of(raw))
    monkeypatch.setattr("numpy.lib.npyio.NpzFile.__getitem__", lambda *_: pytest.fail("read"))
    refused(tmp_path / "000.npz", point, "damaged .compressed.; delete it")


@pytest.mark.parametrize("content", [b"", b"text", b"PK\x03\x04", bytes(1000), b"\x93NUMPY\x01\x00"])
def test_other_files_are_refused(finished, tmp_path, content):
    (tmp_path / "000.npz").write_bytes(content)
    refused(tmp_path / "000.npz", finished[0], r"damaged \(.+\); delete it")


def test_truncated_files_pipes_and_folders_are_refused(finished, tmp_path):
    point, raw = finished
    for share in (0.1, 0.5, 0.9, 0.999):
        (tmp_path / "000.npz").write_bytes(raw[: int(share * len(raw))])
        refused(tmp_path / "000.npz", point, r"damaged \(.+\); delete it")
    os.mkfifo(tmp_path / "001.npz")
    (tmp_path / "002.npz").mkdir()
    for name in ("001.npz", "002.npz", "003.npz"):
        refused(tmp_path / name, point, r"damaged \(no file\); delete it")


def refused(path, point, words):
    with pytest.raises(CheckpointError, match=words) as caught:
        load_point(path, point, 4)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and text.isprintable() and len(text) < len(str(path)) + 250
