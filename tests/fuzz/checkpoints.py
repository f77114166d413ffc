"""Mangled checkpoints, with the digest that they had or with one that fits them."""

import json
from collections.abc import Callable
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.kept import Base, copied, odd_array, resumed, stopped_and_whole
from tests.fuzz.mangle import mangled_bytes, pick
from tests.fuzz.outcomes import Outcome
from tests.scenes import SMALL_SCENE

NAME = "checkpoint.h5"
USER_BLOCK = 512
TEXTS = ("", "{", "[]", "null", "1", "{}", np.nan, b"\xff")
META = (None, [], {}, "x", -1, 1e400, {"scene": 1}, True, "\x1b[31m", "y" * 3000)


def prepare(folder: Path) -> Base:
    """A run that was stopped after two of four observations, and the results of a whole one."""
    from surveysim import run
    from surveysim.scene.scene import load_scene

    def stop(coadds: Any) -> None:
        if coadds.done == 2:
            raise KeyboardInterrupt

    def go(scene: Path, out: Path, **options: Any) -> None:
        run(load_scene(scene), out, **options)

    return stopped_and_whole(folder, SMALL_SCENE, go, stop, NAME)


def mangled(base: Base, rng: np.random.Generator) -> tuple[str, Callable[[], Outcome]]:
    """A mangled checkpoint in the output directory."""
    stopped, whole = base
    path, raw = copied(stopped, NAME)
    how = int(rng.integers(6))
    good: bool | None = None
    if how == 0:
        label = "bytes"
        path.write_bytes(mangled_bytes(raw, rng))
        good = path.read_bytes() == raw or None
        if good is None:
            return label, lambda: resumed(whole, bool(_same(raw)))
    elif how == 1:
        label, content = "bytes with a digest that fits", mangled_bytes(raw[USER_BLOCK:], rng)
        path.write_bytes(_sealed(raw, content))
    else:
        label, content, good = _changed(raw, rng)
        path.write_bytes(_sealed(raw, content))
    return label, lambda: resumed(whole, good)


def _same(raw: bytes) -> bool:
    """Whether the file still holds what it did: what fills its first block up carries nothing."""
    now = (Path("out") / NAME).read_bytes()
    return now[USER_BLOCK:] == raw[USER_BLOCK:] and now[:122] == raw[:122]


def _sealed(raw: bytes, content: bytes) -> bytes:
    """Content with its digest before it, as the program writes it."""
    mark = raw[: raw.index(b": ") + 2]
    return (mark + sha256(content).hexdigest().encode()).ljust(USER_BLOCK, b"\0") + content


def _changed(raw: bytes, rng: np.random.Generator) -> tuple[str, bytes, bool | None]:
    """Another data set or other facts, in a file that is whole HDF5."""
    import h5py

    whole = BytesIO(raw)
    with h5py.File(whole, "r+") as file:
        how = int(rng.integers(12))
        if how < 2:
            label, good = _of_groups(file, rng), False
        elif how < 5:
            label, good = _of_meta(file, rng)
        elif how < 7:
            label, good = _of_seconds(file[pick(rng, sorted(file))], rng)
        else:
            label, good = _of_arrays(file[pick(rng, sorted(file))], rng)
    return label, whole.getvalue()[USER_BLOCK:], good


def _of_groups(file: Any, rng: np.random.Generator) -> str:
    """A group of sums that is gone, empty, there twice, or none."""
    name, how = pick(rng, sorted(file)), int(rng.integers(4))
    if how == 0:
        file.copy(name, "extra")
        return "sums that are there twice"
    if how == 1:
        file["extra"] = np.zeros(3)
        return "an extra data set"
    del file[name]
    if how == 2:
        file.create_group(name)
        return f"{name} as an empty group"
    return f"without {name}"


def _of_arrays(node: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    name, how = pick(rng, sorted(node)), int(rng.integers(8))
    if how == 0:
        node["extra"] = np.zeros(3)
        return "an extra array", False
    values = node[name][()]
    del node[name]
    if how == 1:
        return f"without {name}", False
    if how == 2:
        node.create_group(name)
        return f"{name} as a group", False
    words, array, good = odd_array(values, rng)
    node[name] = array
    return f"{name}: {words}", good


def _of_seconds(node: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    """Other times of stages: they are in the results, but in no sum."""
    seconds, how = json.loads(node.attrs["seconds"]), int(rng.integers(3))
    if how == 0:
        del node.attrs["seconds"]
        return "without seconds", False
    if how == 1:
        value = pick(rng, TEXTS)
        node.attrs["seconds"] = value
        return f"seconds = {value!r}", None if value == "{}" else False
    key, value = pick(rng, sorted(seconds)), pick(rng, META)
    node.attrs["seconds"] = json.dumps(seconds | {key: value})
    return f"seconds: {key} = {value!r}"[:200], False


def _of_meta(file: Any, rng: np.random.Generator) -> tuple[str, bool | None]:
    meta = json.loads(file.attrs["meta"])
    how = int(rng.integers(4))
    if how == 0:
        value = pick(rng, (*TEXTS, '{"scene": 1, "version": 2, "pointing": 3}'))
        file.attrs["meta"] = value
        return f"meta = {value!r}", False
    key = pick(rng, sorted(meta))
    if how == 1:
        del meta[key]
        label = f"meta without {key}"
    else:
        value = pick(rng, META)
        meta[key] = value
        label = f"meta: {key} = {value!r}"[:200]
    file.attrs["meta"] = json.dumps(meta)
    return label, False
