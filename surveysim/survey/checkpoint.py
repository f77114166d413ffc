"""Checkpoints: the running sums of a survey on disk, from which a stopped run continues with the same bits.

A checkpoint is one HDF5 file, replaced as a whole at each save. Its user block, the first 512 bytes, holds the
SHA-256 of the rest.
"""

import json
import math
from collections.abc import Mapping
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.files import atomic_write
from surveysim import __version__
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.setup import Setup
from surveysim.runtime.text_files import one_line
from surveysim.scene.scene import scene_hash
from surveysim.survey.coadds import CoAdds, empty_coadds, row_names
from surveysim.telescope.scans import Scans, samples_per_scan

NAME = "checkpoint.h5"
REASON = 150  # longest reason for refusing a file, in characters

_ARRAYS = ("sums", "weight", "hits", "flipped", "signal_maps", "signal_weight")
_LISTS = ("rows", "bin_noise", "raw_psd", "clean_psd", "compared_psd")
_AGAIN = "delete it and go on with --resume"
_LARGEST = 1e30  # bound of all sums: maps, in single precision, hold up to 3e38
_USER_BLOCK = 512  # bytes, the smallest of HDF5
_MARK = b"surveysim checkpoint, SHA-256 of what follows this block: "


class CheckpointError(ValueError):
    """A checkpoint that cannot be used; the text says why and what to do."""


def save_checkpoint(path: Path, coadds: CoAdds, identity: str) -> None:
    """Write the sums atomically: the old checkpoint is replaced once the new one is on disk.

    Parameters
    ----------
    identity
        Hash of the scene.

    Raises
    ------
    OSError
        If the file cannot be written; it names the file.
    """
    content = _packed(coadds, {"scene": identity, "version": __version__, "seconds": coadds.seconds})
    with atomic_write(path) as partial, open(partial, "wb") as file:
        file.write((_MARK + sha256(content).hexdigest().encode()).ljust(_USER_BLOCK, b"\0"))
        file.write(content)


def _packed(coadds: CoAdds, meta: Mapping[str, Any]) -> memoryview:
    """Make an HDF5 file in memory, without its user block, so that disk errors are plain ones."""
    import h5py

    whole = BytesIO()
    with h5py.File(whole, "w", userblock_size=_USER_BLOCK) as file:
        file.attrs["meta"] = json.dumps(meta, allow_nan=False)
        for name in (*_ARRAYS, *_LISTS):
            file.create_dataset(name, data=np.asarray(getattr(coadds, name)))
    return whole.getbuffer()[_USER_BLOCK:]


def load_checkpoint(path: Path, setup: Setup) -> CoAdds:
    """Read the sums of a scene.

    Raises
    ------
    CheckpointError
        For a checkpoint that is damaged, of another scene or version, or with other content than a run of the scene.
    """
    import h5py

    raw = path.read_bytes() if path.is_file() else b""  # a pipe never ends
    digest = raw[len(_MARK) : len(_MARK) + 64]
    if not raw.startswith(_MARK) or sha256(memoryview(raw)[_USER_BLOCK:]).hexdigest().encode() != digest:
        raise CheckpointError(f"{path}: damaged, or not a checkpoint; {_AGAIN}")
    try:
        with h5py.File(BytesIO(raw), "r") as file:
            meta = read_meta(file.attrs["meta"])
            check_origin(path, meta, scene_hash(setup.scene))
            arrays = _checked_arrays(file, setup)
        seconds = _checked_seconds(meta)
    except CheckpointError:
        raise
    except Exception as error:  # HDF5 and JSON readers raise many types of errors for other files
        reason = one_line(error, REASON)
        raise CheckpointError(f"{path}: not what a run of this scene writes ({reason}); {_AGAIN}") from None
    rows = arrays.pop("rows")
    sums: dict[str, Any] = {name: list(array) if name in _LISTS else array for name, array in arrays.items()}
    return CoAdds(
        **sums,
        rows=[tuple(float(value) for value in row) for row in rows],
        seconds=seconds,
    )


def read_meta(text: object) -> dict[str, Any]:
    """Read the JSON object in a file; raises ValueError for anything else."""
    meta = json.loads(text) if isinstance(text, str) else None
    if not isinstance(meta, dict):
        raise ValueError("meta is no JSON object")
    return meta


def _checked_seconds(meta: Mapping[str, Any]) -> dict[str, float]:
    seconds = meta.get("seconds")
    if not isinstance(seconds, dict):
        raise ValueError("seconds are no JSON object")
    for name, value in seconds.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise ValueError(f"seconds of {name!r} are no time")
    return seconds


def _checked_arrays(file: Any, setup: Setup) -> dict[str, np.ndarray]:
    """Read the arrays of sums by name; raises ValueError for other names, types or shapes than those of the scene.

    They are compared before anything is read: an array of the size that a file declares may not fit in memory.
    """
    if found := set(file) ^ {*_ARRAYS, *_LISTS}:
        raise ValueError(f"missing or unknown: {', '.join(sorted(found))}")
    expected = empty_coadds(setup.analysis)
    done = file["rows"].shape[0]
    if done > setup.scene.observations:
        raise ValueError(f"{done} observations, {setup.scene.observations} are in the survey")
    n_freq, n_compared = samples_per_scan(setup.observing.scans) // 2 + 1, len(setup.analysis.whole_pipelines) - 1
    shapes = {name: getattr(expected, name).shape for name in _ARRAYS}
    of_one: dict[str, tuple[int, ...]] = {
        "rows": (len(row_names(setup.analysis)),),
        "raw_psd": (n_freq,),
        "clean_psd": (n_freq,),
    }
    n_bin = 0 if setup.analysis.region is None else len(setup.analysis.region.rings.ell)
    of_one |= {"bin_noise": (len(setup.analysis.data_set_names), n_bin), "compared_psd": (n_compared, n_freq)}
    shapes |= {name: (done, *of_one[name]) if done else (0,) for name in _LISTS}
    types = {name: getattr(expected, name).dtype for name in _ARRAYS}
    for name, shape in shapes.items():
        kind = file[name].dtype
        if file[name].shape != shape:
            raise ValueError(f"{name} has the shape {file[name].shape}, {shape} is expected")
        if kind != types.get(name, kind) or kind.kind not in "if" or (kind.kind == "i" and name in _LISTS):
            raise ValueError(f"{name} is of {kind}")
    arrays = {name: file[name][()] for name in shapes}
    _check_values(arrays, setup.analysis, setup.observing.scans)
    return arrays


def _check_values(arrays: Mapping[str, np.ndarray], analysis: AnalysisSetup, scans: Scans) -> None:
    """Raise ValueError for sums that no observations could give."""
    for name in (*_ARRAYS, "raw_psd", "clean_psd", "compared_psd"):
        if not (np.abs(arrays[name]) < _LARGEST).all():
            raise ValueError(f"{name} has values that are not finite, or above {_LARGEST:g}")
    for name in ("weight", "hits", "signal_weight", "raw_psd", "clean_psd", "compared_psd"):
        if (arrays[name] < 0).any():
            raise ValueError(f"{name} has negative values")
    if not (arrays["bin_noise"] >= 0).all():  # infinite where an observation has no data
        raise ValueError("bin_noise has negative values, or some that are no numbers")
    if arrays["weight"][arrays["hits"] == 0].any() or arrays["sums"][arrays["weight"] == 0].any():
        raise ValueError("there are sums without hits or without weight")
    if len(arrays["rows"]):
        columns = dict(zip(row_names(analysis), arrays["rows"].T, strict=True))
        _check_rows(columns, scans.n_scans)
        noise = np.column_stack([columns[f"noise_mk2_{name}"] for name in analysis.data_set_names])
        _check_noise(noise, arrays["bin_noise"])


def _check_noise(noise: np.ndarray, bin_noise: np.ndarray) -> None:
    """Raise ValueError unless map noise (n_obs, n_set) is infinite exactly where its bins (..., n_bin) are."""
    if np.isnan(noise).any() or (bin_noise.size and (np.isinf(bin_noise) != np.isinf(noise)[..., None]).any()):
        raise ValueError("noise and bin_noise are not of the same observations with data")


def _check_rows(columns: Mapping[str, np.ndarray], n_scans: int) -> None:
    """Raise ValueError for rows of other observations; NaN is an unknown value."""
    if not np.array_equal(columns["observation"], np.arange(len(columns["observation"]))):
        raise ValueError("rows are not those of the first observations in order")
    for name, column in columns.items():
        if name.startswith("discarded_") and not ((column >= 0) & (column <= n_scans)).all():
            raise ValueError(f"{name} has other values than numbers of scans")
        if name.startswith(("noise_mk2_", "b2_mk2", "pwv_mm", "wind_speed")) and (column < 0).any():
            raise ValueError(f"{name} has negative values")


def check_streams(directory: Path, setup: Setup, done: int) -> None:
    """Raise CheckpointError for saved time-streams of the first `done` observations of another scene."""
    identity, n_samp = (
        scene_hash(setup.scene),
        setup.observing.scans.n_scans * samples_per_scan(setup.observing.scans),
    )
    for number in range(done):
        path = directory / f"{number:04d}.h5"
        if path.exists() and not _is_stream(path, (setup.camera.n_det, n_samp), identity, number):
            raise CheckpointError(
                f"{path}: not the time-streams of observation {number} of this scene; start anew with --force, or "
                "write elsewhere with --out"
            )


def _is_stream(path: Path, shape: tuple[int, int], identity: str, number: int) -> bool:
    import h5py

    if not path.is_file():  # a pipe never ends
        return False
    try:
        with h5py.File(path, "r") as file:
            same = file.attrs["scene_sha256"] == identity and file.attrs["observation"] == number
            return bool(same) and file["data"].shape == shape
    except Exception:  # HDF5 readers raise many types of errors for other files
        return False


def check_origin(path: Path, found: Mapping[str, Any], identity: str) -> None:
    """Raise CheckpointError unless a file has this version and the hash of this scene."""
    for key, expected in (("version", __version__), ("scene", identity)):
        if (value := found.get(key)) != expected:
            raise CheckpointError(
                f"{path}: from another {key} (found {str(value)[:12]!r}, expected {expected[:12]!r}); "
                "start anew with --force, or write elsewhere with --out"
            )
