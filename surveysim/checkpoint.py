"""Checkpoints: the running sums of a survey on disk, so that a stopped run goes on with the same bits."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mapmaker.files import whole_file
from surveysim import __version__
from surveysim.coadds import CoAdds

_ARRAYS = ("sums", "weight", "hits", "flipped", "window", "window_weight")
_LISTS = ("raw_psd", "clean_psd", "compared_psd")


class CheckpointError(ValueError):
    """A checkpoint that can't be used; the text says why and what to do."""


def save_checkpoint(path: Path, coadds: CoAdds, scene_hash: str) -> None:
    """Write the sums atomically: the old checkpoint stays whole until the new one is."""
    meta = {"scene": scene_hash, "version": __version__, "seconds": coadds.seconds}
    with whole_file(path) as partial, open(partial, "wb") as file:
        np.savez(
            file,
            meta=json.dumps(meta),
            rows=np.array(coadds.rows),
            raw_psd=np.array(coadds.raw_psd),
            clean_psd=np.array(coadds.clean_psd),
            compared_psd=np.array(coadds.compared_psd),
            **{name: getattr(coadds, name) for name in _ARRAYS},
        )


def load_checkpoint(path: Path, scene_hash: str) -> CoAdds:
    """Read the sums back.

    Raises CheckpointError for a damaged checkpoint or one of another scene or version.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            meta = json.loads(str(file["meta"]))
            arrays = {name: file[name] for name in (*_ARRAYS, "rows", *_LISTS)}
            found = {key: str(meta[key]) for key in ("version", "scene")}
            seconds = dict(meta["seconds"])
    except Exception as error:  # zip, npy and JSON readers raise a wide range for damaged bytes
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise CheckpointError(f"{path}: damaged ({reason}); delete it and run without --resume") from None
    check_origin(path, found, scene_hash)
    rows = arrays.pop("rows")
    return CoAdds(
        **{name: list(array) if name in _LISTS else array for name, array in arrays.items()},
        rows=[tuple(float(value) for value in row) for row in rows],
        seconds=seconds,
    )


def check_origin(path: Path, found: Mapping[str, str], scene_hash: str) -> None:
    """Raise CheckpointError unless a file is of this version and scene; `found` has both."""
    for key, expected in (("version", __version__), ("scene", scene_hash)):
        if found[key] != expected:
            raise CheckpointError(
                f"{path}: of another {key} (found {found[key][:12]}, expected {expected[:12]}); "
                "run without --resume, or with --out elsewhere"
            )
