"""Provenance on a page: versions, seed, hash, date, run time, and the sources of a scene's values."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from surveysim.report.html.components import Block, Cell, Grid, Terms, Text, cell
from surveysim.runtime.numbers import count, day_and_time, duration, number

MANY_FILES = 40  # files of a folder that are counted instead of listed, such as time-streams
_ASSUMED = re.compile(r"(?P<key>\S+) = (?P<value>.*?): (?P<source>(?:assumed|calibrated).*)", re.DOTALL)


def provenance(content: Mapping[str, Any]) -> Terms:
    """Return terms on scene, versions, date, engine and files of the results."""
    run = content["run"]
    packages = ", ".join(f"{name} {version}" for name, version in content["packages"].items())
    terms = [
        ("Scene", content["scene"]),
        ("Seed", str(content["seed"])),
        ("Hash of the scene", content.get("scene_sha256", "")),
        ("surveysim", content["surveysim"]),
        ("Python", content["python"]),
        ("Packages", packages),
        ("Date", day_and_time(run.get("date", ""))),
        ("Engine", run.get("engine", "")),
        ("Workers", str(run["workers"])),
        ("Wall time", duration(run["wall_s"])),
        ("Files", _files(content.get("files", ()))),
    ]
    return Terms(tuple((term, what) for term, what in terms if what), code=True)


def _files(names: Sequence[str]) -> str:
    """Names of files; for a folder with many files, their number."""
    folders: dict[str, list[str]] = {}
    for name in names:
        folders.setdefault(name.rpartition("/")[0], []).append(name)
    return ", ".join(
        f"{folder}/ ({len(found)} files)" if len(found) > MANY_FILES else ", ".join(found)
        for folder, found in folders.items()
    )


def stage_times(run: Mapping[str, Any]) -> Grid:
    """Return the time of each stage, summed over all workers."""
    each = run["stage_ns_per_detector_sample"]
    rows = [
        (cell(name), Cell(number(seconds, 2), seconds), Cell(number(each[name], 2), each[name]))
        for name, seconds in sorted(run["stage_s"].items(), key=lambda item: -item[1])
    ]
    total_s, total_ns = sum(run["stage_s"].values()), sum(each.values())
    rows.append((cell("in all"), Cell(number(total_s, 2), total_s), Cell(number(total_ns, 2), total_ns)))
    columns = ("stage", "time of all workers [s]", "for each detector-sample [ns]")
    return Grid("stage-table", "Time by stage", columns, tuple(rows))


def sources(scene: Mapping[str, Any]) -> tuple[Block, ...]:
    """List values of the scene with comments that call them assumed or calibrated, with these comments."""
    found = [match for line in scene["assumed"] if (match := _ASSUMED.fullmatch(line))]
    if not found:
        return (Text(("No comment of the scene says that a value is assumed or calibrated.",)),)
    intro = (
        "These values of the scene are not published: its comments say that they are assumed, or calibrated, and"
        f" against what ({count(len(found))} of them). All others stand in scene.json as they were run."
    )
    rows = tuple((cell(f"{item['key']} = {item['value']}"), cell(item["source"])) for item in found)
    return (Text((intro,)), Grid("source-table", "Assumed or calibrated", ("value", "source"), rows))
