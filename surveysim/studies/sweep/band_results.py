"""Results of the sweeps of a camera of several bands, and one table of all."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.studies.sweep.bands import MultiBandSweep, band_sweep_hash
from surveysim.studies.sweep.result import SweepResult


@dataclass(frozen=True)
class MultiBandSweepResult:
    """Finished sweeps of the bands of a camera, by name.

    Attributes
    ----------
    bands
        Results, without those of bands that were finished in a run that this one resumed.
    summaries
        Content of summary.json of all bands.
    """

    sweep: MultiBandSweep
    bands: dict[str, SweepResult]
    summaries: dict[str, dict[str, Any]]
    wall_s: float


def sweep_entries(result: MultiBandSweepResult) -> dict[str, dict[str, Any]]:
    """Return the entry of each band, as summary.json has it: its number of points, and the best one."""
    return {name: _entry(content) for name, content in result.summaries.items()}


def _entry(content: Mapping[str, Any]) -> dict[str, Any]:
    points = content["points"]
    entry = {"scene": content["scene"], "points": len(points), "detectors": points[0]["n_det"]}
    if not content["best"]:
        return entry
    best = points[content["best"][0]]
    score = best["scores"].get(ACTUAL) or {"sigma_ukcmb2": best["forecast_ukcmb2"][ACTUAL]}
    entry |= {"detectors": best["n_det"], "best": best["label"]}
    return entry | {key: score[key] for key in ("sigma_ukcmb2", "error_ukcmb2") if key in score}


def band_sweep_summary(result: MultiBandSweepResult) -> dict[str, Any]:
    """Return the content of summary.json above the directories of the bands, without the provenance."""
    first = next(iter(result.summaries.values()))
    scene = next(iter(result.sweep.bands.values())).points[0].scene
    run = {key: first["run"][key] for key in ("engine", "workers")}
    return {
        "scene": result.sweep.name,
        "title": result.sweep.title,
        "seed": scene.seed,
        "scene_sha256": band_sweep_hash(result.sweep),
        "observations_of_survey": scene.observations,
        "bands": sweep_entries(result),
        "warnings": [f"{name}: {line}" for name, item in result.summaries.items() for line in item["warnings"]],
        "run": run | {"wall_s": result.wall_s},
    }
