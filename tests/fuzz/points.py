"""Mangled files of a sweep's finished points."""

import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.kept import Base, copied, odd_array, resumed, stopped_and_whole
from tests.fuzz.mangle import mangled_bytes, pick
from tests.fuzz.outcomes import Outcome
from tests.scenes import SMALL_SCENE

SMALLER = SMALL_SCENE.replace("observations = 4", "observations = 2")
SWEEP = SMALLER.replace("mask_separation_f_lambda = 1.3\n", "").replace('["uncorrelated", "white"]', "[]")
SWEEP += '\n[sweep]\n"scan.speed" = ["3 arcmin / s", "4 arcmin / s"]\n'
NAME = "points/000.npz"
FOLDER = "a folder"
VALUES = (None, [], {}, "x", -1, 0, 1e400, float("nan"), True, "\x1b[31m", [1], {"a": 1}, 10**30)


def prepare(folder: Path) -> Base:
    """A sweep that was stopped after the first of two points, and the results of a whole one."""
    from surveysim import run_sweep

    def stop(done: int) -> None:
        if done == 1:
            raise KeyboardInterrupt

    return stopped_and_whole(folder, SWEEP, run_sweep, stop, NAME)


def mangled(base: Base, rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled point in the output directory."""
    stopped, whole = base
    path, raw = copied(stopped, NAME)
    how = int(rng.integers(8))
    good: bool | None = None
    if how == 0:
        label = "bytes"
        path.write_bytes(mangled_bytes(raw, rng))
    elif how == 1:
        label, good = _other_file(path, raw, rng)
    else:
        label, good = _changed(path, rng)
    refusals = (1, 2) if label == FOLDER else (2,)  # where no file can be written is the machine's fault
    return label, lambda: resumed(whole, good, refusals)


def _other_file(path: Path, raw: bytes, rng: np.random.Generator) -> tuple[str, bool | None]:
    how = int(rng.integers(5))
    if how == 0:
        path.with_name("001.npz").write_bytes(raw)
        return "the file of another point", False
    if how == 1:
        path.with_name("999.npz").write_bytes(raw)
        return "a point that the sweep does not have", None
    path.unlink()
    if how == 2:
        path.mkdir()
        return FOLDER, False
    if how == 3:
        buffer = io.BytesIO()
        np.savez(buffer, meta=np.array([{"a": 1}], dtype=object), allow_pickle=True)
        path.write_bytes(buffer.getvalue())
        return "pickled objects", False
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("meta.npy", b"\0" * 10**8)
    return "a zip that grows a hundredfold", False


def _changed(path: Path, rng: np.random.Generator) -> tuple[str, bool | None]:
    with np.load(path) as file:
        arrays = dict(file)
    meta = json.loads(str(arrays["meta"]))
    how = int(rng.integers(6))
    if how < 3:
        name = pick(rng, sorted(arrays.keys() - {"meta"}))
        if how == 0:
            del arrays[name]
            label, good = f"without {name}", False
        else:
            words, arrays[name], good = odd_array(arrays[name], rng)
            label = f"{name}: {words}"
    else:
        label, good = _of_meta(meta, rng)
        arrays["meta"] = np.array(json.dumps(meta))
    np.savez(path, **arrays)
    return label, good


def _of_meta(meta: dict[str, Any], rng: np.random.Generator) -> tuple[str, bool | None]:
    """A value below `meta` removed or replaced; one of another type, or that is not finite, has to be refused."""
    place: Any = meta
    path = []
    while isinstance(place, dict) and place and (not path or rng.random() < 0.8):
        parent, key = place, pick(rng, sorted(place))
        path.append(key)
        place = place[key]
    name = ".".join(path)
    if rng.random() < 0.3:
        del parent[key]
        return f"meta without {name}", None if len(path) > 2 and path[1] != "sets" and path[0] == "rest" else False
    value = pick(rng, VALUES)
    parent[key] = value
    kinds = {float: (int, float), int: (int,), str: (str,), list: (list,), dict: (dict,)}
    right_type = isinstance(value, kinds.get(type(place), (object,))) and not isinstance(value, bool)
    finite = not isinstance(value, float) or np.isfinite(value)
    return f"meta: {name} = {value!r} for {place!r}"[:300], None if right_type and finite else False
