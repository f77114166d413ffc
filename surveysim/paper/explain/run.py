"""Explanation of the paper's findings: surveys of all ingredients, comparison and files."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from mapmaker.files import write_ecsv
from surveysim.output.directory import OutputDirectory, begin, claimed, finish
from surveysim.output.drawings import undrawn
from surveysim.output.expected_study_files import of_explanation
from surveysim.output.writer import write_summary
from surveysim.paper.explain.comparison import compared
from surveysim.paper.explain.findings import findings
from surveysim.paper.explain.ingredients import Explained
from surveysim.paper.explain.second_layer import second_layer_figure, trusted_rows, winds
from surveysim.paper.explain.values import Values, survey_values
from surveysim.paper.manifest import PAPER
from surveysim.report.explanation import entry_table, second_layer_table
from surveysim.runtime.engine import Engine
from surveysim.runtime.provenance import made_by, now
from surveysim.runtime.table import Table
from surveysim.scene.scene import Scene, scene_hash
from surveysim.studies.budget.points import as_options

UNITS = dict.fromkeys(("drawn_b2", "fitted_b2", "lowest_layer_b2", "highest_layer_b2"), "mK2 rad(-5/3)")
UNITS |= {"raw_mk2": "mK2"}


def explain(
    asked: Explained, out: Path, engine: Engine, *, progress: Callable[[], None] = lambda: None, force: bool = False
) -> dict[str, Any]:
    """Simulate the surveys of an explanation, compare them with the paper, and write tables, a figure and a report.

    Surveys that an interrupted call has finished are read, not simulated again.

    Parameters
    ----------
    asked
        Surveys, from `explained`.
    out
        Output directory.
    engine
        Workers.
    progress
        Called after each observation.
    force
        Replace files of the user, and results of other settings.

    Returns
    -------
    Content of the key `explained` of summary.json.

    Raises
    ------
    OutputError
        For a directory that another job writes to or, unless with `force`, with other content.
    """
    scenes = (*asked.scenes, *asked.layers.values())
    identity = sha256(" ".join(map(scene_hash, scenes)).encode()).hexdigest()
    with claimed(out, of_explanation([item.name for item in asked.ingredients], identity), force) as place:
        return _explain(asked, place, engine, progress)


def _explain(asked: Explained, place: OutputDirectory, engine: Engine, progress: Callable[[], None]) -> dict[str, Any]:
    start = perf_counter()
    names = [_file(item.name) for item in asked.ingredients]
    there = {name: _read(place, name, scene) for name, scene in zip(names, asked.scenes, strict=True)}
    begin(place, removed=lambda name: there.get(name) is None)
    try:
        surveys = []
        for name, scene in zip(names, asked.scenes, strict=True):
            values = there[name]
            if values is None:
                values = survey_values(scene, asked.scenes[0], engine, progress)
                write_ecsv(place.path / name, values, UNITS, {"scene": scene.name, "scene_sha256": scene_hash(scene)})
            else:
                for _ in values["observation"]:
                    progress()
            surveys.append(values)
        of_layers = {key: winds(scene, engine, progress) for key, scene in asked.layers.items()}
        content = _content(asked, surveys, trusted_rows(of_layers))
        run = {"date": now(), "engine": engine.kind, "wall_s": perf_counter() - start}
        written = [place.path / name for name in names]
        written += [_write(place.path, table) for table in (entry_table(content), second_layer_table(content))]
        written += _draw(place.path, content)
        write_summary(place.path, {"paper": PAPER, "explained": content} | made_by() | {"run": run}, written)
    finally:
        finish(place)
    return content


def _file(ingredient: str) -> str:
    return f"observations_{ingredient}.ecsv"


def _read(place: OutputDirectory, name: str, scene: Scene) -> Values | None:
    """Read the values of a survey that an earlier call has written; None for those of another scene."""
    if name not in place.mine:
        return None
    from astropy.table import Table as AstropyTable

    found = AstropyTable.read(place.path / name, format="ascii.ecsv")
    if found.meta["scene_sha256"] != scene_hash(scene):
        return None
    return {column: np.asarray(found[column]) for column in found.colnames}


def _content(asked: Explained, surveys: list[Values], layers: list[dict[str, Any]]) -> dict[str, Any]:
    one = asked.scenes[0]
    pairs = zip(asked.ingredients, asked.scenes, strict=True)
    return {
        "observations": one.observations,
        "seed": one.seed,
        "ingredients": [
            {
                "name": item.name,
                "title": item.title,
                "origin": item.origin,
                "options": as_options(item.settings),
                "scene_sha256": scene_hash(scene),
            }
            for item, scene in pairs
        ],
        "findings": [
            {
                "name": finding.name,
                "title": finding.title,
                "paper": list(finding.paper),
                "paper_error": finding.paper_error,
                "entries": [vars(entry) for entry in compared(finding, surveys)],
            }
            for finding in findings()
        ],
        "second_layer": layers,
    }


def _write(directory: Path, table: Table) -> Path:
    path = directory / f"{table.name}.ecsv"
    write_ecsv(path, table.in_files, table.units, table.meta)
    return path


def _draw(directory: Path, content: dict[str, Any]) -> list[Path]:
    from surveysim.report.figures.layout import draw_figure

    path = directory / "second_layer.png"
    try:
        draw_figure(second_layer_figure(content["second_layer"], content["observations"]), path)
    except Exception as error:  # matplotlib raises a wide range: of fonts, formulas, sizes
        undrawn("figure 'second_layer'", error)
        return []
    return [path]
