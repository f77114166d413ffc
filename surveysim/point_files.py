"""What a sweep keeps of a point, and its small file, by which an interrupted sweep goes on."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mapmaker.bandpower import BandPower
from mapmaker.files import whole_file
from mapmaker.uncertainty import ErrorBudget
from mapmaker.window import Window
from surveysim import __version__
from surveysim.checkpoint import CheckpointError, check_origin
from surveysim.scores import Control, DataSetScore

_OF_BAND, _OF_WINDOW = ("weight", "ell", "cumulative"), ("ell", "transmission", "deviations")
_OF_CONTROL = ("factor", "weights", "noise")
_OF_SET = ("noise_psds", "signal_psd", "weights", "bin_noise", "kept")


@dataclass(frozen=True)
class PointResult:
    """Scores by data set, or why there are none; forecasts of sigma(A) [uK_CMB^2] by data set.

    `off` is the actual data's forecast over the simulation, less 1, with the standard error of that, empty where there
    is only one of them; `flags` say why the forecast may be off.
    `discarded` is the share of discarded scans by data set, empty where it is not known, and `discarded_by_weather`
    that of quarters of the observations (`surveysim.discards`). `skies` is equal for points whose windows are measured
    with the same skies. `wall_s` is the time that the point took since it was started or, the last time, resumed.
    """

    n_det: int
    scores: dict[str, DataSetScore]
    forecast_ukcmb2: dict[str, float]
    off: list[float]
    flags: list[str]
    discarded: dict[str, float]
    discarded_by_weather: list[dict[str, Any]]
    skies: str
    unscored: str
    wall_s: float


def point_file(directory: Path, number: int) -> Path:
    """Where a finished point is kept."""
    return directory / f"{number:03d}.npz"


def point_checkpoint(directory: Path, number: int) -> Path:
    """Where a point under way is kept."""
    return directory / f"{number:03d}.checkpoint.h5"


def finished_points(directory: Path) -> dict[int, Path]:
    """Files of finished points by number."""
    return {int(path.stem): path for path in sorted(directory.glob("[0-9][0-9][0-9].npz"))}


def save_point(path: Path, result: PointResult, scene_hash: str) -> None:
    """Write a finished point atomically."""
    meta = {
        "scene": scene_hash,
        "version": __version__,
        "sets": {name: _numbers(item) for name, item in result.scores.items()},
        "rest": {key: value for key, value in vars(result).items() if key != "scores"},
    }
    arrays = {f"{name}/{key}": array for name, item in result.scores.items() for key, array in _arrays(item).items()}
    with whole_file(path) as partial, open(partial, "wb") as file:
        np.savez(file, meta=json.dumps(meta), **arrays)


def load_point(path: Path, scene_hash: str) -> PointResult:
    """Read a finished point back; raises CheckpointError for a damaged file or one of another scene or version."""
    try:
        with np.load(path, allow_pickle=False) as file:
            meta = json.loads(str(file["meta"]))
            found = {key: str(meta[key]) for key in ("version", "scene")}
            scores = {name: _score(file, name, numbers) for name, numbers in meta["sets"].items()}
            result = PointResult(scores=scores, **meta["rest"])
    except Exception as error:  # zip, npy and JSON readers raise a wide range for damaged bytes
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise CheckpointError(f"{path}: damaged ({reason}); delete it and go on with --resume") from None
    check_origin(path, found, scene_hash)
    return result


def _numbers(item: DataSetScore) -> dict[str, Any]:
    found = {"n_det": item.n_det, "band": _of(item.band, _OF_BAND), "budget": vars(item.budget)}
    if item.control is not None:
        found |= {"control": _of(item.control, _OF_CONTROL), "plain": _of(item.plain, _OF_BAND)}
    return found


def _of(record: Any, arrays: tuple[str, ...]) -> dict[str, float]:
    """The numbers of a record, less its arrays."""
    return {key: value for key, value in vars(record).items() if key not in arrays}


def _parts(item: DataSetScore) -> dict[str, tuple[Any, tuple[str, ...]]]:
    """Records of a score that have arrays, and their names."""
    parts = {"": (item, _OF_SET), "band.": (item.band, _OF_BAND), "window.": (item.window, _OF_WINDOW)}
    if item.control is not None:
        parts |= {"control.": (item.control, _OF_CONTROL), "plain.": (item.plain, _OF_BAND)}
    return parts


def _arrays(item: DataSetScore) -> dict[str, np.ndarray]:
    return {f"{part}{key}": getattr(of, key) for part, (of, keys) in _parts(item).items() for key in keys}


def _score(file: Any, name: str, numbers: dict[str, Any]) -> DataSetScore:
    def arrays(part: str, keys: tuple[str, ...]) -> dict[str, np.ndarray]:
        return {key: file[f"{name}/{part}{key}"] for key in keys}

    controlled = "control" in numbers
    return DataSetScore(
        name=name,
        n_det=numbers["n_det"],
        band=BandPower(**numbers["band"], **arrays("band.", _OF_BAND)),
        budget=ErrorBudget(**numbers["budget"]),
        window=Window(**arrays("window.", _OF_WINDOW)),
        control=Control(**numbers["control"], **arrays("control.", _OF_CONTROL)) if controlled else None,
        plain=BandPower(**numbers["plain"], **arrays("plain.", _OF_BAND)) if controlled else None,
        **arrays("", _OF_SET),
    )
