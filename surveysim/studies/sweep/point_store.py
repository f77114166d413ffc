"""Results of the points of a sweep, stored in small files from which an interrupted sweep resumes."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from zipfile import ZIP_STORED

import numpy as np
from pydantic import Field, ValidationError

from mapmaker.bandpower import BandPower
from mapmaker.files import atomic_write
from mapmaker.transfer_function import TransferFunction
from mapmaker.uncertainty import ErrorBudget
from surveysim import __version__
from surveysim.metrics.map_noise import Quantity
from surveysim.reduction.cleaning_pipelines import ACTUAL, OPTIMAL
from surveysim.reduction.data_set import DataSetKind
from surveysim.results.metrics import MetricResults
from surveysim.runtime.text_files import one_line
from surveysim.scene.scene import Scene, scene_hash
from surveysim.studies.sweep.axes import Point
from surveysim.studies.sweep.point_metrics import (
    Budget,
    Metric,
    Numbers,
    check_metrics,
    check_responses,
    metric_arrays,
    metric_numbers,
    read_metrics,
)
from surveysim.survey.checkpoint import REASON, CheckpointError, check_origin, read_meta
from surveysim.survey.scores import Control, DataSetScore

_APART = (
    "scores",
    "metrics",
    "metric_forecasts",
    "kept_error",
)  # fields that the JSON part has elsewhere, or not at all
_OF_BAND, _OF_TRANSFER = ("weight", "ell", "cumulative"), ("ell", "transmission", "deviations")
_OF_CONTROL = ("factor", "weights", "noise")
_OF_SET = ("noise_psds", "signal_psd", "weights", "bin_noise", "kept")
_NEVER_NEGATIVE = (
    "noise_psds",
    "signal_psd",
    "weights",
    "kept",
    "band.weight",
    "band.ell",
    "transfer_function.ell",
    "control.weights",
    "plain.weight",
    "plain.ell",
)
_Share = Annotated[float, Field(ge=0, le=1)]


@dataclass(frozen=True)
class PointResult:
    """Results of one point.

    Attributes
    ----------
    observations
        Number of simulated observations; 0 for a forecast.
    scores
        By data set; empty if there are none, with the reason in `unscored`.
    forecast_ukcmb2
        Forecasts of sigma(A) by data set.
    off
        Forecast over simulation of the actual data, minus 1, and its standard error; empty unless both exist.
    flags
        Reasons why the forecast may be off.
    discarded, discarded_by_weather
        Fractions of discarded scans by data set, empty if unknown, and for quarters of the observations
        (`surveysim.survey.discarded_scans`).
    skies
        Key that is equal for points whose transfer functions are measured with the same skies.
    wall_s
        Run time since the start or last resumption of the point.
    metrics
        Quantities of all metrics of a run, by data set and key.
    metric_forecasts
        Quantities of all metrics of a forecast, by data set and key.
    kept_error
        Relative error of the scans of the actual data that a forecast expects to be kept; 0 where it is unknown.
    """

    n_det: int
    observations: int
    scores: dict[str, DataSetScore]
    forecast_ukcmb2: dict[str, float]
    off: list[float]
    flags: list[str]
    discarded: dict[str, float]
    discarded_by_weather: list[dict[str, Any]]
    skies: str
    unscored: str
    wall_s: float
    metrics: MetricResults
    metric_forecasts: dict[str, dict[str, Quantity]]
    kept_error: float = 0.0


def point_file(number: int, observations: int, of_survey: int) -> str:
    """Name of the file of a finished point, or of one with the first of its observations."""
    return f"{number:03d}.npz" if observations == of_survey else f"{number:03d}_{observations:04d}.npz"


def point_checkpoint(directory: Path, number: int) -> Path:
    """Path of the checkpoint of an unfinished point."""
    return directory / f"{number:03d}.checkpoint.h5"


def finished_points(directory: Path) -> dict[int, Path]:
    """Files of finished points by number."""
    return {int(path.stem): path for path in sorted(directory.glob("[0-9][0-9][0-9].npz"))}


def save_point(path: Path, result: PointResult, identity: str) -> None:
    """Write a finished point of the scene with this hash, atomically."""
    meta = {
        "scene": identity,
        "version": __version__,
        "sets": {name: _numbers(item) for name, item in result.scores.items()},
        "metrics": metric_numbers(result.metrics),
        "rest": {key: value for key, value in vars(result).items() if key not in _APART},
    }
    arrays: dict[str, Any] = {
        f"{name}/{key}": array for name, item in result.scores.items() for key, array in _arrays(item).items()
    }
    arrays |= dict(metric_arrays(result.metrics))
    with atomic_write(path) as partial, open(partial, "wb") as file:
        np.savez(file, meta=json.dumps(meta), **arrays)


def load_run(path: Path) -> tuple[PointResult, str, str]:
    """Read the scores of a finished run: with the hash of its scene, and the version that wrote them.

    Raises
    ------
    CheckpointError
        For a file that is damaged, or of a version with other content.
    """
    with _opened(path) as file:
        meta = _Meta.model_validate(read_meta(str(file["meta"])))
        result = _result(file, meta)
        if ACTUAL not in result.scores:
            raise ValueError("no score of the actual data")
        actual = result.scores[ACTUAL]
        _check_arrays(result, len(actual.noise_psds), len(actual.transfer_function.deviations))
        check_responses(result.metrics, actual.signal_psd.size)
        return result, meta.scene, meta.version


def load_point(path: Path, point: Point, observations: int) -> PointResult:
    """Read a finished point, or one with so many of its first observations.

    Raises
    ------
    CheckpointError
        For a file that is damaged, of another scene or version, or with content that does not fit the point.
    """
    with _opened(path) as file:
        meta = read_meta(str(file["meta"]))
        check_origin(path, meta, scene_hash(point.scene))
        result = _result(file, _Meta.model_validate(meta))
        _check_point(result, point, observations)
        return result


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file of arrays; errors of its content become a CheckpointError."""
    try:
        if not path.is_file():  # a pipe never ends
            raise ValueError("no file")
        with np.load(path, allow_pickle=False) as file:
            if any(item.compress_type != ZIP_STORED for item in file.zip.infolist()):
                raise ValueError("compressed")  # by others: a few bytes can hold gigabytes
            yield file
    except CheckpointError:
        raise
    except ValidationError as error:  # its own text has a line for each fault, and quotes what it found
        first = error.errors()[0]
        reason = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    except Exception as error:  # zip, npy and JSON readers raise a wide range for damaged bytes
        reason = str(error)
    else:
        return
    raise CheckpointError(f"{path}: damaged ({one_line(reason, REASON)}); delete it and go on with --resume")


class _Band(Numbers):
    sigma_ukcmb2: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    error_ukcmb2: float
    ell_eff: float
    fwhm_ell: float


class _Control(Numbers):
    sampling: float
    population: float


class _Set(Numbers):
    kind: Annotated[DataSetKind, Field(strict=False)]
    n_det: Annotated[int, Field(ge=1)]
    band: _Band
    budget: Budget
    block: list[Annotated[int, Field(ge=0)]] | None = None
    control: _Control | None = None
    plain: _Band | None = None


class _Quarter(Numbers):
    b2_min_mk2: float
    b2_max_mk2: float
    observations: Annotated[int, Field(ge=1)]
    discarded: dict[str, _Share]


class _Rest(Numbers):
    n_det: int
    observations: Annotated[int, Field(ge=1)]
    forecast_ukcmb2: dict[str, Annotated[float, Field(gt=0)]]
    off: Annotated[list[float], Field(max_length=2)]
    flags: list[str]
    discarded: dict[str, _Share]
    discarded_by_weather: list[_Quarter]
    skies: str
    unscored: str
    wall_s: Annotated[float, Field(ge=0, allow_inf_nan=False)]


class _Meta(Numbers):
    """JSON part of a point's file."""

    scene: str
    version: str
    sets: dict[str, _Set]
    metrics: dict[str, dict[str, Metric]]
    rest: _Rest


def _result(file: Any, meta: _Meta) -> PointResult:
    numbers = {name: item.model_dump(exclude_none=True) for name, item in meta.sets.items()}
    result = PointResult(
        scores={name: _score(file, name, item) for name, item in numbers.items()},
        metrics=read_metrics(file, meta.metrics),
        metric_forecasts={},
        **meta.rest.model_dump(),
    )
    known = {f"{name}/{key}" for name, item in result.scores.items() for key in _arrays(item)}
    known |= {name for name, _ in metric_arrays(result.metrics)}
    if others := set(file.files) - known - {"meta"}:
        raise ValueError(f"unknown: {', '.join(sorted(others))}")
    return result


def _check_point(result: PointResult, point: Point, observations: int) -> None:
    """Raise ValueError for scores that do not fit the scene of a point."""
    score, names = point.scene.score, _data_sets(point.scene)
    if result.n_det != point.n_det or any(item.n_det > point.n_det for item in result.scores.values()):
        raise ValueError(f"other numbers of detectors than {point.n_det}")
    if bool(result.scores) == bool(result.unscored) or (result.scores and ACTUAL not in result.scores):
        raise ValueError("neither a score nor a reason for none, or both")
    others = [item.name for item in result.scores.values() if item.kind is not DataSetKind.MASKED]
    if others := [name for name in others if name not in names]:
        raise ValueError(f"no data set of the scene: {others[0]}")
    n_bin = {len(item.signal_psd) for item in result.scores.values()}
    check_metrics(result.metrics, point.scene, set(result.scores), max(n_bin, default=0))
    if result.observations != observations:
        raise ValueError(f"{result.observations} observations, not {observations}")
    _check_arrays(result, score.jackknives, score.signal_sims.skies)


def _check_arrays(result: PointResult, jackknives: int, skies: int) -> None:
    """Raise ValueError for arrays that do not fit each other."""
    n_obs, n_bin = result.observations, {item.signal_psd.size for item in result.scores.values()}
    sizes = {"noise_psds": (jackknives, *n_bin), "transfer_function.deviations": (skies, *n_bin)}
    sizes |= dict.fromkeys(("weights", "control.weights"), (n_obs,))
    sizes |= dict.fromkeys(("bin_noise", "control.noise"), (n_obs, *n_bin))
    for name, item in result.scores.items():
        if item.block is not None and (item.block.shape != (n_obs,) or set(np.diff(item.block, prepend=0)) - {0, 1}):
            raise ValueError(f"{name}: its blocks are not those of {n_obs} observations")
        for key, array in _arrays(item).items():
            shapes = {sizes.get(key, tuple(n_bin))} if key != "kept" else {(), sizes["weights"]}
            if np.shape(array) not in shapes or np.asarray(array).dtype != float:
                raise ValueError(f"{name}/{key} has the shape {np.shape(array)} of {np.asarray(array).dtype}")
            if key in _NEVER_NEGATIVE and not ((array >= 0) & np.isfinite(array)).all():
                raise ValueError(f"{name}/{key} has values below 0 or none")
        _check_noise(f"{name}/bin_noise", item.weights, item.bin_noise, item.band.weight)
        if item.control is not None:
            _check_noise(f"{name}/control.noise", item.control.weights, item.control.noise, item.band.weight)


def _check_noise(name: str, weights: np.ndarray, noise: np.ndarray, bin_weight: np.ndarray) -> None:
    """Raise ValueError for invalid noise where it has a weight; elsewhere it may be infinite or unknown."""
    used = noise[np.ix_(weights > 0, bin_weight > 0)]
    if not ((used >= 0) & np.isfinite(used)).all():
        raise ValueError(f"{name} has values below 0 or none where there are data")


def _data_sets(scene: Scene) -> set[str]:
    """Names of the data sets that a scene may have for all detectors."""
    return {ACTUAL, OPTIMAL, *scene.score.noise_only_sets, *("+".join(steps) for steps in scene.cleaning.compare)}


def _numbers(item: DataSetScore) -> dict[str, Any]:
    found = {"kind": item.kind, "n_det": item.n_det, "band": _of(item.band, _OF_BAND), "budget": vars(item.budget)}
    if item.block is not None:
        found["block"] = item.block.tolist()
    if item.control is not None:
        found |= {"control": _of(item.control, _OF_CONTROL), "plain": _of(item.plain, _OF_BAND)}
    return found


def _of(record: Any, arrays: tuple[str, ...]) -> dict[str, float]:
    """Scalar fields of a record, without its arrays."""
    return {key: value for key, value in vars(record).items() if key not in arrays}


def _parts(item: DataSetScore) -> dict[str, tuple[Any, tuple[str, ...]]]:
    """Records of a score that have arrays, and their names."""
    parts = {
        "": (item, _OF_SET),
        "band.": (item.band, _OF_BAND),
        "transfer_function.": (item.transfer_function, _OF_TRANSFER),
    }
    if item.control is not None:
        parts |= {"control.": (item.control, _OF_CONTROL), "plain.": (item.plain, _OF_BAND)}
    return parts


def _arrays(item: DataSetScore) -> dict[str, np.ndarray]:
    return {f"{part}{key}": getattr(of, key) for part, (of, keys) in _parts(item).items() for key in keys}


def _score(file: Any, name: str, numbers: dict[str, Any]) -> DataSetScore:
    def arrays(part: str, keys: tuple[str, ...]) -> dict[str, Any]:
        return {key: file[f"{name}/{part}{key}"] for key in keys}

    controlled = "control" in numbers
    return DataSetScore(
        name=name,
        kind=numbers["kind"],
        n_det=numbers["n_det"],
        band=BandPower(**numbers["band"], **arrays("band.", _OF_BAND)),
        budget=ErrorBudget(**numbers["budget"]),
        transfer_function=TransferFunction(**arrays("transfer_function.", _OF_TRANSFER)),
        control=Control(**numbers["control"], **arrays("control.", _OF_CONTROL)) if controlled else None,
        plain=BandPower(**numbers["plain"], **arrays("plain.", _OF_BAND)) if controlled else None,
        block=np.array(numbers["block"]) if "block" in numbers else None,
        **arrays("", _OF_SET),
    )
