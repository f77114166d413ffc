"""Checkpoints: the sums over finished observations on disk, from which a run continues with the same bits.

A checkpoint is one HDF5 file, replaced as a whole at each save, with a group for each node of the tree of sums. Its
user block, the first 512 bytes, holds the SHA-256 of the rest.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.files import atomic_write
from surveysim import __version__
from surveysim.reduction.noise_weights import is_weights_file, weights_file
from surveysim.reduction.setup import Setup
from surveysim.runtime.text_files import one_line
from surveysim.scene.scene import survey_hash
from surveysim.survey.coadd_tree import is_node
from surveysim.survey.coadds import LISTS, CoAdds, array_names, empty_coadds
from surveysim.survey.rows import row_names
from surveysim.telescope.scans import samples_per_scan

NAME, WEIGHTS = "checkpoint.h5", "noise_weights"
REASON = 150  # longest reason for refusing a file, in characters

_AGAIN = "delete it and go on with --resume"
_LARGEST = 1e30  # bound of all sums: maps, in single precision, hold up to 3e38
_USER_BLOCK = 512  # bytes, the smallest of HDF5
_MARK = b"surveysim checkpoint, SHA-256 of what follows this block: "


class CheckpointError(ValueError):
    """A checkpoint that cannot be used; the text says why and what to do."""


def save_checkpoint(path: Path, nodes: Sequence[CoAdds], setup: Setup) -> None:
    """Write nodes of sums atomically: the old checkpoint is replaced once the new one is on disk.

    Raises
    ------
    OSError
        If the file cannot be written; it names the file.
    """
    numbers = _numbers(nodes)
    meta: dict[str, Any] = {
        "scene": survey_hash(setup.scene),
        "version": __version__,
        "pointing": _pointing_hash(setup, numbers),
    }
    meta |= _extent(setup) | _subtracted(setup)
    content = _packed(nodes, (*array_names(setup.analysis), *LISTS), meta)
    with atomic_write(path) as partial, open(partial, "wb") as file:
        file.write((_MARK + sha256(content).hexdigest().encode()).ljust(_USER_BLOCK, b"\0"))
        file.write(content)


def _subtracted(setup: Setup) -> dict[str, str]:
    """Identify the bright sky that the streams of a pass are cleaned without."""
    sky = setup.bright_sky_mk
    return {} if sky is None else {"bright_sky": sha256(np.ascontiguousarray(sky).tobytes()).hexdigest()}


def _extent(setup: Setup) -> dict[str, int]:
    """Numbers of observations and nights of the survey, on which the starts of its observations depend."""
    plan = setup.scene.schedule
    return {"observations": setup.scene.observations} | ({"nights": plan.nights} if plan else {})


def _numbers(nodes: Iterable[CoAdds]) -> np.ndarray:
    """Numbers of the observations of nodes, (n_obs,)."""
    return np.concatenate([np.zeros(0, int), *(np.arange(node.first, node.end) for node in nodes)])


def _pointing_hash(setup: Setup, numbers: np.ndarray) -> str:
    """Hash the starts and angles of observations: a survey of other nights may have others."""
    angles = setup.observing.angles
    rows = (angles.start_mjd[numbers], angles.elevation_rad[numbers], angles.parallactic_rad[numbers])
    return sha256(b"".join(np.ascontiguousarray(row).tobytes() for row in rows)).hexdigest()


def _packed(nodes: Sequence[CoAdds], names: Sequence[str], meta: Mapping[str, Any]) -> memoryview:
    """Make an HDF5 file in memory, without its user block, so that disk errors are plain ones."""
    import h5py

    whole = BytesIO()
    with h5py.File(whole, "w", userblock_size=_USER_BLOCK) as file:
        file.attrs["meta"] = json.dumps(meta, allow_nan=False)
        for node in nodes:
            group = file.create_group(f"{node.first:09d}")
            group.attrs["seconds"] = json.dumps(node.seconds, allow_nan=False)
            for name in names:
                group.create_dataset(name, data=np.asarray(getattr(node, name)))
    return whole.getbuffer()[_USER_BLOCK:]


def load_checkpoint(path: Path, setup: Setup) -> list[CoAdds]:
    """Read the nodes of a survey's sums, in order; none from an earlier pass of an iterative map-maker.

    Raises
    ------
    CheckpointError
        For a checkpoint that is damaged, of another scene or version, of observations that the scene does not have or
        has at other times, or with other content than a run of the scene.
    """
    import h5py

    raw = path.read_bytes() if path.is_file() else b""  # a pipe never ends
    digest = raw[len(_MARK) : len(_MARK) + 64]
    if not raw.startswith(_MARK) or sha256(memoryview(raw)[_USER_BLOCK:]).hexdigest().encode() != digest:
        raise CheckpointError(f"{path}: damaged, or not a checkpoint; {_AGAIN}")
    try:
        with h5py.File(BytesIO(raw), "r") as file:
            meta = read_meta(file.attrs["meta"])
            check_origin(path, meta, survey_hash(setup.scene))
            if meta.get("bright_sky") != _subtracted(setup).get("bright_sky"):
                return []
            nodes = [_checked_node(file[name], setup) for name in sorted(file)]
    except CheckpointError:
        raise
    except Exception as error:  # HDF5 and JSON readers raise a wide range for what is none
        raise _foreign(path, error) from None
    _check_extent(path, nodes, setup, meta)
    return nodes


def _foreign(path: Path, error: Exception) -> CheckpointError:
    return CheckpointError(f"{path}: not what a run of this scene writes ({one_line(error, REASON)}); {_AGAIN}")


def _check_extent(path: Path, nodes: Sequence[CoAdds], setup: Setup, meta: Mapping[str, Any]) -> None:
    """Raise CheckpointError unless nodes are apart, and their observations are those of the scene."""
    if any(node.first < before.end for before, node in zip(nodes, nodes[1:], strict=False)):
        raise _foreign(path, ValueError("nodes overlap"))
    end = max((node.end for node in nodes), default=0)
    if end > setup.scene.observations:
        raise CheckpointError(
            f"{path}: has observations up to number {end - 1}, found observations = {setup.scene.observations}; "
            f"{end} or more is expected, or another directory with --out"
        )
    if _pointing_hash(setup, _numbers(nodes)) != str(meta.get("pointing")):
        raise CheckpointError(
            f"{path}: {_other_times(_extent(setup), meta)}; or start anew with --force, or write elsewhere with --out"
        )


def _other_times(found: Mapping[str, int], before: Mapping[str, Any]) -> str:
    """Say which number of nights keeps the times of finished observations: that in proportion to the observations."""
    text = f"observations = {found['observations']} with schedule.nights = {found.get('nights')} moves finished "
    text += "observations to other times"
    try:
        nights, rest = divmod(found["observations"] * int(before["nights"]), int(before["observations"]))
    except (KeyError, TypeError, ValueError, ZeroDivisionError):  # no such numbers in the file
        return f"{text}; schedule.nights in proportion to observations keeps them"
    if rest:
        ratio = f"{before['observations']} observations in {before['nights']} nights"
        return f"{text}; both in the proportion of the finished run, {ratio}, keep them"
    return f"{text}; schedule.nights = {nights} keeps them"


def read_meta(text: object) -> dict[str, Any]:
    """Read the JSON object in a file; raises ValueError for anything else."""
    meta = json.loads(text) if isinstance(text, str) else None
    if not isinstance(meta, dict):
        raise ValueError("meta is no JSON object")
    return meta


def _checked_seconds(seconds: Mapping[str, Any]) -> dict[str, float]:
    for name, value in seconds.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise ValueError(f"seconds of {name!r} are no time")
    return dict(seconds)


def _checked_node(group: Any, setup: Setup) -> CoAdds:
    """Read a node; raises ValueError for one that is not of the tree of sums."""
    arrays = _checked_arrays(group, setup)
    rows = [tuple(float(value) for value in row) for row in arrays.pop("rows")]
    node = empty_coadds(setup.analysis, flips=False)
    for name, array in arrays.items():
        setattr(node, name, list(array) if name in LISTS else array)
    node.rows, node.seconds = rows, _checked_seconds(read_meta(group.attrs["seconds"]))
    if not is_node(setup, node):
        raise ValueError(f"observations {node.first} to {node.end - 1} are no node of the sums")
    return node


def _checked_arrays(group: Any, setup: Setup) -> dict[str, np.ndarray]:
    """Read the arrays of sums by name; raises ValueError for other names, types or shapes than those of the scene.

    They are compared before anything is read: an array of the size that a file declares may not fit in memory.
    """
    names = array_names(setup.analysis)
    if found := set(group) ^ {*names, *LISTS}:
        raise ValueError(f"missing or unknown: {', '.join(sorted(found))}")
    done = group["rows"].shape[0]
    single = done == 1 and group["flipped"].shape[:1] == (0,)
    expected = empty_coadds(setup.analysis, flips=not single)
    n_freq, n_compared = samples_per_scan(setup.observing.scans) // 2 + 1, len(setup.analysis.whole_pipelines) - 1
    n_bin = 0 if setup.analysis.region is None else len(setup.analysis.region.rings.ell)
    shapes = {name: getattr(expected, name).shape for name in names} | {
        "rows": (done, len(row_names(setup.analysis))),
        "raw_psd": (done, n_freq),
        "clean_psd": (done, n_freq),
        "bin_noise": (done, len(setup.analysis.data_set_names), n_bin),
        "compared_psd": (done, n_compared, n_freq),
    }
    types = {name: getattr(expected, name).dtype for name in names}
    for name, shape in shapes.items():
        kind = group[name].dtype
        if group[name].shape != shape or not done:
            raise ValueError(f"{name} has the shape {group[name].shape}, {shape} is expected")
        if kind != types.get(name, kind) or kind.kind not in "if" or (kind.kind == "i" and name in LISTS):
            raise ValueError(f"{name} is of {kind}")
    arrays = {name: group[name][()] for name in shapes}
    _check_values(arrays, setup)
    return arrays


def _check_values(arrays: Mapping[str, np.ndarray], setup: Setup) -> None:
    """Raise ValueError for sums that no observations could give."""
    for name in (*array_names(setup.analysis), "raw_psd", "clean_psd", "compared_psd"):
        if not (np.abs(arrays[name]) < _LARGEST).all():
            raise ValueError(f"{name} has values that are not finite, or above {_LARGEST:g}")
    for name in ("weight", "hits", "signal_weight", "raw_psd", "clean_psd", "compared_psd"):
        if (arrays[name] < 0).any():
            raise ValueError(f"{name} has negative values")
    if not (arrays["bin_noise"] >= 0).all():  # infinite where an observation has no data
        raise ValueError("bin_noise has negative values, or some that are no numbers")
    if "split_weight" in arrays and (arrays["split_weight"] < 0).any():
        raise ValueError("split_weight has negative values")
    if arrays["weight"][arrays["hits"] == 0].any() or arrays["sums"][arrays["weight"] == 0].any():
        raise ValueError("there are sums without hits or without weight")
    columns = dict(zip(row_names(setup.analysis), arrays["rows"].T, strict=True))
    _check_rows(columns, setup)
    noise = np.column_stack([columns[f"noise_mk2_{name}"] for name in setup.analysis.data_set_names])
    _check_noise(noise, arrays["bin_noise"])


def _check_noise(noise: np.ndarray, bin_noise: np.ndarray) -> None:
    """Raise ValueError unless map noise (n_obs, n_set) is infinite exactly where its bins (..., n_bin) are."""
    if np.isnan(noise).any() or (bin_noise.size and (np.isinf(bin_noise) != np.isinf(noise)[..., None]).any()):
        raise ValueError("noise and bin_noise are not of the same observations with data")


def _check_rows(columns: Mapping[str, np.ndarray], setup: Setup) -> None:
    """Raise ValueError for rows of other observations; NaN is an unknown value."""
    numbers = columns["observation"]
    if not (0 <= numbers[0] <= 1e9 and np.array_equal(numbers, numbers[0] // 1 + np.arange(len(numbers)))):
        raise ValueError("rows are not those of consecutive observations")
    for name, column in columns.items():
        if name.startswith("discarded_") and not ((column >= 0) & (column <= setup.observing.scans.n_scans)).all():
            raise ValueError(f"{name} has other values than numbers of scans")
        if name == "flagged" and not ((column >= 0) & (column <= 1)).all():
            raise ValueError("flagged has other values than fractions")
        if name.startswith(("noise_mk2_", "b2_mk2", "pwv_mm", "wind_speed")) and (column < 0).any():
            raise ValueError(f"{name} has negative values")


def check_streams(directory: Path, setup: Setup, nodes: Sequence[CoAdds]) -> None:
    """Raise CheckpointError for saved time-streams of finished observations of another scene."""
    identity, n_samp = (
        survey_hash(setup.scene),
        setup.observing.scans.n_scans * samples_per_scan(setup.observing.scans),
    )
    for number in _numbers(nodes):
        path = directory / f"{number:04d}.h5"
        if path.exists() and not _is_stream(path, (setup.camera.n_det, n_samp), identity, number):
            raise CheckpointError(
                f"{path}: not the time-streams of observation {number} of this scene; start anew with --force, or "
                "write elsewhere with --out"
            )


def weights_directory(checkpoint: Path) -> Path:
    """Directory of the noise weights beside a checkpoint."""
    return checkpoint.with_name(checkpoint.name.replace(NAME, WEIGHTS))


def check_weights(directory: Path, setup: Setup, nodes: Sequence[CoAdds]) -> None:
    """Raise CheckpointError unless the noise weights of all finished observations are there."""
    for number in _numbers(nodes).tolist():
        if not is_weights_file(path := weights_file(directory, number), setup, number):
            raise CheckpointError(
                f"{path}: missing, or not the noise weights of observation {number} of this scene; start anew with"
                " --force, or write elsewhere with --out"
            )


def _is_stream(path: Path, shape: tuple[int, int], identity: str, number: int) -> bool:
    import h5py

    if not path.is_file():  # a pipe never ends
        return False
    try:
        with h5py.File(path, "r") as file:
            same = file.attrs["survey_sha256"] == identity and file.attrs["observation"] == number
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
