"""Checkpoints: the running sums of a survey on disk, so that a stopped run goes on with the same bits.

One HDF5 file, which grows by an observation at a time: it is replaced as a whole, so that what it held before is there
until the new one is on the disk. Its user block, the first 512 bytes, holds the SHA-256 of all that follows.
"""

import errno
import json
import os
from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.files import whole_file
from surveysim import __version__
from surveysim.coadds import CoAdds

NAME = "checkpoint.h5"

_ARRAYS = ("sums", "weight", "hits", "flipped", "window", "window_weight")
_LISTS = ("rows", "bin_noise", "raw_psd", "clean_psd", "compared_psd")
_USER_BLOCK = 512  # bytes, the least that HDF5 has
_MARK = b"surveysim checkpoint, SHA-256 of what follows this block: "


class CheckpointError(ValueError):
    """A checkpoint that can't be used; the text says why and what to do."""


def save_checkpoint(path: Path, coadds: CoAdds, scene_hash: str) -> None:
    """Write the sums atomically: the old checkpoint stays whole until the new one is on the disk.

    Raises OSError that names the file where it can't be written.
    """
    content = _packed(coadds, {"scene": scene_hash, "version": __version__, "seconds": coadds.seconds})
    try:
        with whole_file(path) as partial, open(partial, "wb") as file:
            file.write((_MARK + sha256(content).hexdigest().encode()).ljust(_USER_BLOCK, b"\0"))
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:  # of a write, it names no file
        raise OSError(error.errno or errno.EIO, error.strerror or str(error), str(path)) from None


def _packed(coadds: CoAdds, meta: Mapping[str, Any]) -> memoryview:
    """An HDF5 file in memory, less its user block: the disk sees plain writes, whose errors are plain."""
    import h5py

    whole = BytesIO()
    with h5py.File(whole, "w", userblock_size=_USER_BLOCK) as file:
        file.attrs["meta"] = json.dumps(meta)
        for name in (*_ARRAYS, *_LISTS):
            file.create_dataset(name, data=np.asarray(getattr(coadds, name)))
    return whole.getbuffer()[_USER_BLOCK:]


def load_checkpoint(path: Path, scene_hash: str) -> CoAdds:
    """Read the sums back.

    Raises CheckpointError for a damaged checkpoint or one of another scene or version.
    """
    import h5py

    raw = Path(path).read_bytes()
    digest = raw[len(_MARK) : len(_MARK) + 64]
    if not raw.startswith(_MARK) or sha256(memoryview(raw)[_USER_BLOCK:]).hexdigest().encode() != digest:
        raise CheckpointError(f"{path}: damaged, or no checkpoint at all; delete it and go on with --resume")
    with h5py.File(BytesIO(raw), "r") as file:
        meta = json.loads(file.attrs["meta"])
        check_origin(path, meta, scene_hash)
        arrays = {name: file[name][()] for name in (*_ARRAYS, *_LISTS)}
    rows = arrays.pop("rows")
    return CoAdds(
        **{name: list(array) if name in _LISTS else array for name, array in arrays.items()},
        rows=[tuple(float(value) for value in row) for row in rows],
        seconds=meta["seconds"],
    )


def check_origin(path: Path, found: Mapping[str, Any], scene_hash: str) -> None:
    """Raise CheckpointError unless a file is of this version and scene; `found` has both."""
    for key, expected in (("version", __version__), ("scene", scene_hash)):
        if found[key] != expected:
            raise CheckpointError(
                f"{path}: of another {key} (found {found[key][:12]}, expected {expected[:12]}); "
                "start anew with --force, or write elsewhere with --out"
            )
