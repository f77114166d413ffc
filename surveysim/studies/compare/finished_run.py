"""Finished runs as comparisons read them, from their directories."""

import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mapmaker.printable import printable, shortened
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.runtime.errors import SceneError
from surveysim.studies.sweep.point_store import PointResult, load_run
from surveysim.survey.checkpoint import CheckpointError

SCORES, SPECTRA, STREAMS, OBSERVATIONS = (
    "scores.npz",
    "tables/map_psd.ecsv",
    "tables/timestream_psd.ecsv",
    "tables/observations.ecsv",
)
RUN = "the directory of a run, or of a point of a sweep as in SWEEP/points/3"
_OTHERS = {  # keys of other summaries, and the directories to give in their place
    "budget": f"found a budget; {RUN}, is expected",
    "optimum": f"found an optimum; {RUN}, is expected",
    "points": f"found a sweep; {RUN}, is expected",
    "bands": "found a camera of several bands; the directory of a band, as in DIR/bands/150, is expected",
    "accuracy": f"found results of 'surveysim accuracy'; {RUN}, is expected",
    "compared": f"found a comparison; {RUN}, is expected",
}
_LONGEST_REASON = 150


class _Score(BaseModel):
    sigma_ukcmb2: Annotated[float, Field(gt=0, allow_inf_nan=False)]
    error_ukcmb2: float | None


class _Stopped(BaseModel):
    observations_of_survey: int


class _Summary(BaseModel):
    """Part of summary.json that comparisons read."""

    model_config = ConfigDict(strict=True)

    scene: str
    title: str
    seed: int
    surveysim: str
    scene_sha256: str
    detectors: int
    observations: int
    discarded: dict[str, float] = {}
    scores: dict[str, _Score]
    stopped: _Stopped | None = None


@dataclass(frozen=True)
class FinishedRun:
    """A finished run.

    Attributes
    ----------
    directory, label
        Its directory, and a short name among the runs of a comparison.
    summary, scene
        Content of summary.json and scene.json.
    settings
        Values of its scene file, by section; empty without one.
    result
        Its scores with all that paired errors need; None without scores.npz.
    without
        Reason for a missing `result`; else empty.
    """

    directory: Path
    label: str
    summary: Mapping[str, Any]
    scene: Mapping[str, Any]
    settings: Mapping[str, Any]
    result: PointResult | None
    without: str

    @property
    def discarded(self) -> Mapping[str, float]:
        """Fractions of discarded scans by data set."""
        return self.summary.get("discarded", {})

    @property
    def origin(self) -> tuple[int, str] | None:
        """Seed and version, which random numbers depend on; None if errors can't be paired."""
        return None if self.result is None else (self.summary["seed"], self.summary["surveysim"])

    def table(self, name: str) -> Mapping[str, np.ndarray]:
        """Return the columns of one of its tables; empty without the file."""
        from astropy.table import Table

        path = self.directory / name
        if not path.is_file():
            return {}
        try:
            found = Table.read(path, format="ascii.ecsv")
        except Exception as error:  # a reader of a damaged table raises a wide range
            raise SceneError(f"{path}: can't be read ({_reason(error)}); a table of a run is expected") from None
        return {column: np.asarray(found[column]) for column in found.colnames}


def read_runs(directories: Sequence[str | Path]) -> tuple[FinishedRun, ...]:
    """Read the directories of two or more finished runs; raises SceneError with one line for another directory."""
    paths = [Path(directory) for directory in directories]
    if len(paths) < 2:
        raise SceneError(f"compare: found {len(paths)} directory; two or more are expected")
    resolved = [path.resolve() for path in paths]
    for place, path in enumerate(paths):
        if resolved.index(resolved[place]) < place:
            raise SceneError(f"{path}: found twice; different directories are expected")
    return tuple(_read_run(path, label) for path, label in zip(paths, run_labels(resolved), strict=True))


def run_labels(paths: Sequence[Path]) -> list[str]:
    """Shorten absolute paths to what distinguishes them, with `points/` before the number of a point."""
    common = Path(os.path.commonpath(paths))
    labels = []
    for path in paths:
        own = path.relative_to(common).parts
        if path.parent.name == "points" and len(own) < 2:
            own = path.parts[-2:]
        labels.append("/".join(own) or path.name)
    return labels


def _read_run(path: Path, label: str) -> FinishedRun:
    if not path.is_dir():
        raise SceneError(f"{path}: {'not a directory' if path.exists() else 'no such directory'}; {RUN}, is expected")
    if not (path / "summary.json").exists():
        raise SceneError(f"{path}: found no results; {RUN}, is expected")
    summary = _read(path / "summary.json")
    for key, reason in _OTHERS.items():
        if key in summary:
            raise SceneError(f"{path}: {reason}")
    if "scores" not in summary or "seed" not in summary:
        raise SceneError(f"{path}: found other results; {RUN}, is expected")
    if ACTUAL not in summary["scores"]:
        why = summary.get("unscored") or "its scene has no section [score]"
        raise SceneError(f"{path}: found a run without a score ({why}); one with a score is expected")
    try:
        _Summary.model_validate(summary)
    except ValidationError as error:
        first = error.errors()[0]
        reason = f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
        raise SceneError(f"{path / 'summary.json'}: damaged ({reason}); {RUN}, is expected") from None
    result, without = _scores(path, summary)
    return FinishedRun(path, label, summary, _read(path / "scene.json"), _settings(path), result, without)


def _scores(path: Path, summary: Mapping[str, Any]) -> tuple[PointResult | None, str]:
    if not (path / SCORES).exists():
        return None, f"its directory has no {SCORES}, which runs of surveysim 0.7 and later write"
    try:
        result, scene, version = load_run(path / SCORES)
    except CheckpointError as error:
        return None, str(error).partition(";")[0]
    if (scene, version) != (summary["scene_sha256"], summary["surveysim"]):
        return None, f"its {SCORES} is of another run"
    return result, ""


def _settings(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads((path / "scene.toml").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}


def _read(path: Path) -> dict[str, Any]:
    try:
        if not path.is_file():
            raise OSError("no file")
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise SceneError(f"{path}: can't be read ({_reason(error)}); {RUN}, is expected") from None
    if not isinstance(content, dict):
        raise SceneError(f"{path}: found {type(content).__name__}; a JSON object is expected")
    return content


def _reason(error: Exception) -> str:
    return shortened(printable(str(error)), _LONGEST_REASON)
