"""Manifest of reproduced tables and figures: the runs that made them, in summary.json of their directory."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from surveysim.output.directory import OTHERWISE, OutputDirectory, begin
from surveysim.output.lock import OutputError
from surveysim.output.writer import write_summary, write_text
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.strict_json import strict_json
from surveysim.scene.scene import Scene, scene_hash

SUMMARY = "summary.json"
PAPER = "Sayers et al. 2010"


def earlier_runs(
    place: OutputDirectory, items: Sequence[str], scenes: Sequence[tuple[Scene, list[str]]], force: bool
) -> list[dict[str, Any]]:
    """Read the earlier runs of a directory, without the items that are made again, and remove the files of these.

    Parameters
    ----------
    place
        The output directory.
    items
        Names of the items that are made again, such as "figure 5".
    scenes
        Scenes with the items made of each.
    force
        Replace items that were made of other scenes.

    Raises
    ------
    OutputError
        For items that were made of other scenes, unless with `force`.
    """
    path, content, old, left = place.path / SUMMARY, {}, [], []
    try:
        if SUMMARY in place.mine:
            content = json.loads(path.read_text(encoding="utf-8"))
            if not force:
                _check_scenes(place.path, content["runs"], items, scenes)
            old = [name for run in content["runs"] for item in items for name in run["items"].get(item, ())]
            left = [run for run in (_without(run, items) for run in content["runs"]) if run["items"]]
    except (LookupError, TypeError, AttributeError, json.JSONDecodeError):
        raise OutputError(f"{path}: damaged; delete it, or write elsewhere with --out") from None
    begin(place, removed=lambda name: name in old or not left)
    if left:
        write_text(path, strict_json(content | {"runs": left}, indent=2) + "\n")
    return left


def _check_scenes(
    directory: Path, runs: Sequence[dict[str, Any]], items: Sequence[str], scenes: Sequence[tuple[Scene, list[str]]]
) -> None:
    """Raise OutputError for an existing item that was made of other scenes."""
    for run in runs:
        for item in (item for item in items if item in run["items"]):
            before = {scene["scene_sha256"] for scene in run["scenes"] if item in scene["items"]}
            if before != {scene_hash(scene) for scene, its in scenes if item in its}:
                raise OutputError(f"{directory}: holds {item} of other scenes or settings; {OTHERWISE}")


def _without(run: dict[str, Any], items: Sequence[str]) -> dict[str, Any]:
    """Remove items from a run, and the scenes that only these were made of."""
    kept = {name: files for name, files in run["items"].items() if name not in items}
    failed = {name: reason for name, reason in run["failed"].items() if name not in items}
    scenes = [scene | {"items": [name for name in scene["items"] if name not in items]} for scene in run["scenes"]]
    return run | {"items": kept, "failed": failed, "scenes": [scene for scene in scenes if scene["items"]]}


def write_record(
    out: Path,
    earlier: list[dict[str, Any]],
    *,
    made: Mapping[str, list[Path]],
    failed: Mapping[str, str],
    scenes: Sequence[tuple[Scene, list[str]]],
    engine: str,
    workers: int,
    wall_s: float,
) -> None:
    """Write summary.json, with this run after the earlier ones, and report.html.

    Parameters
    ----------
    out
        The output directory.
    earlier
        Earlier runs, from `earlier_runs`.
    made
        Files of each item.
    failed
        Reasons of the items that could not be made.
    scenes
        Simulated scenes with the items made of each.
    engine, workers, wall_s
        Kind of the engine, number of workers, and run time [s].
    """
    run = {
        **made_by(),
        "date": now(),
        "engine": engine,
        "workers": workers,
        "wall_s": wall_s,
        "items": {name: [path.name for path in paths] for name, paths in made.items()},
        "failed": dict(failed),
        "scenes": [
            {
                "scene": scene.name,
                "seed": scene.seed,
                "scene_sha256": scene_hash(scene),
                "observations": scene.observations,
                "items": items,
            }
            for scene, items in scenes
        ],
    }
    runs = [*earlier, run]
    files = [out / name for each in runs for names in each["items"].values() for name in names]
    write_summary(out, {"paper": PAPER, "runs": runs}, files)
