"""Points of a budget: the scene without some of its stages, for each stage alone and for pairs."""

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from shlex import quote
from typing import Any

from surveysim.runtime.errors import SceneError
from surveysim.scene.bands import TABLE
from surveysim.scene.error_lines import error_lines
from surveysim.scene.metrics import SIGMA_KEY, metric_keys
from surveysim.scene.scene import Origin, Scene, load_scene, read_scene, scene_hash, scene_of
from surveysim.scene.shipped import find_scene
from surveysim.scene.units import file_value, shown
from surveysim.studies.actual_data import actual_alone
from surveysim.studies.budget.stages import CLEANING, StageList, stages_of
from surveysim.studies.sweep.axes import Point, Sweep, sweep_point

WHOLE = 0  # number of the point with all stages
Removed = frozenset[str]  # names of the stages that a point is without


@dataclass(frozen=True)
class Cost:
    """Numbers of the points with and without a stage; None for one that does not exist."""

    present: int | None
    absent: int | None

    @property
    def exists(self) -> bool:
        """True if both points exist."""
        return self.present is not None and self.absent is not None


@dataclass(frozen=True)
class BudgetRow:
    """A stage of a budget.

    Attributes
    ----------
    name, title
        Of the stage.
    removed
        The stage in the whole scene, less the stages that need it.
    added
        The stage in the least scene, with the stages that it needs; None for the floor.
    reason
        Why a point does not exist; empty where all do.
    """

    name: str
    title: str
    removed: Cost
    added: Cost | None
    reason: str


@dataclass(frozen=True)
class PairRow:
    """Numbers of four points of two stages: with both, without the first, without the second, and without both."""

    names: tuple[str, str]
    points: tuple[int, ...]


@dataclass(frozen=True)
class Budget:
    """A scene made ready for its budget.

    Attributes
    ----------
    sweep
        Points, the whole scene first; all have one seed.
    removed
        Stages that each point is without.
    least
        Number of the point with the least stages: the floor alone. None if it does not exist.
    rows
        One for each stage.
    pairs
        One for each pair of stages, if they are asked for.
    """

    sweep: Sweep
    stages: StageList
    removed: tuple[Removed, ...]
    least: int | None
    rows: tuple[BudgetRow, ...]
    pairs: tuple[PairRow, ...]

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.sweep.name


def load_budget(
    scene: Scene | str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    metric: str = SIGMA_KEY,
    pairs: bool = False,
) -> Budget:
    """Find the stages of a scene, and check and prepare the scenes without them.

    Parameters
    ----------
    scene
        A scene that `load_scene` returned, the path of its file, or its name.
    overrides
        Values by dotted key, as for `load_scene`; for a path or a name.
    metric
        Key of the quantity that costs are of.
    pairs
        Add the points without two stages.

    Raises
    ------
    SceneError
        For a scene that can't be run, one without [score] or with one stage alone, a sweep, a camera of several bands,
        a scene that is not as its file has it, and a metric that it does not have.
    """
    origin = _origin(scene, overrides or {})
    _, content = read_scene(origin.path)
    for table, what in (("sweep", "a sweep"), (TABLE, "a camera of several bands")):
        if table in content:
            raise SceneError(f"{origin.path}: {table}: found {what}; a scene of one band, without [sweep], is expected")

    def scene_at(settings: dict[str, Any]) -> Scene:
        return scene_of(origin.path, origin.text, content, origin.overrides | settings)

    whole = scene_at({})
    if whole.score and metric not in (known := metric_keys(whole.score.metrics)):
        raise SceneError(f"{origin.path}: metric: found {shown(metric)}; one of {', '.join(known)} is expected")
    stages = stages_of(whole)
    if len(stages.stages) < 2:
        raise SceneError(f"{origin.path}: found {', '.join(stages.stages)} alone; two stages or more are expected")
    costs = {name: _sets(stages, name) for name in stages.stages}
    quartets = _quartets(stages) if pairs else {}
    wanted = [frozenset(), *(item for sets in (*costs.values(), *quartets.values()) for item in sets)]
    points, reasons = _points(origin.path, stages, dict.fromkeys(wanted), scene_at)
    numbers = {item: number for number, item in enumerate(points)}
    rows = tuple(_row(stages, name, sets, numbers, reasons) for name, sets in costs.items())
    found = {names: tuple(numbers[item] for item in sets if item in numbers) for names, sets in quartets.items()}
    return Budget(
        Sweep(origin.path, (), tuple(points.values()), origin, WHOLE, metric),
        stages,
        tuple(points),
        numbers.get(frozenset(stages.stages) - {stages.floor}),
        rows,
        tuple(PairRow(names, four) for names, four in found.items() if len(four) == 4),
    )


def _origin(scene: Scene | str | Path, overrides: Mapping[str, Any]) -> Origin:
    if not isinstance(scene, Scene):
        path = find_scene(scene)
        values = {key: file_value(value) for key, value in overrides.items()}
        return Origin(path.absolute(), read_scene(path)[0], values)
    if scene.origin is None or scene_hash(load_scene(scene.origin.path, scene.origin.overrides)) != scene_hash(scene):
        raise SceneError(f"{scene.name}: found a scene that is not as its file has it; one of load_scene is expected")
    return scene.origin


def _sets(stages: StageList, name: str) -> tuple[Removed, ...]:
    """Stages that the points of a row are without: the whole scene with and without the stage, then the least scene."""
    of, floor, dependent = frozenset({name}), frozenset({stages.floor}), stages.dependent(name)
    if name == stages.floor:
        return dependent, dependent | of
    without = frozenset(stages.stages) - floor - stages.required(name)
    return dependent, dependent | of, without - of, without


def _quartets(stages: StageList) -> dict[tuple[str, str], tuple[Removed, ...]]:
    """Stages that the four points of each pair are without; no pairs of a stage with one that it needs."""
    found: dict[tuple[str, str], tuple[Removed, ...]] = {}
    for one, other in combinations([name for name in stages.stages if name != CLEANING], 2):
        if other not in stages.dependent(one) and one not in stages.dependent(other):
            common = stages.dependent(one) | stages.dependent(other)
            found[one, other] = (common, common | {one}, common | {other}, common | {one, other})
    return found


def _points(
    path: Path, stages: StageList, wanted: Iterable[Removed], scene_at: Callable[[dict[str, Any]], Scene]
) -> tuple[dict[Removed, Point], dict[Removed, str]]:
    """Make the points that exist, and the reasons why others do not; raises SceneError where the whole scene fails."""
    points: dict[Removed, Point] = {}
    reasons: dict[Removed, str] = {}
    for item in wanted:
        settings, number = stages.removal(item), len(points)
        if not stages.has_noise_without(item):
            reasons[item] = f"{_label(stages, item)} has no noise"
            continue
        try:
            scene = actual_alone(scene_at(settings))
            points[item] = sweep_point(number, (number,), _label(stages, item), settings, scene)
        except SceneError as error:
            lines = [line.removeprefix(f"{path}: ") for line in str(error).splitlines()]
            if not item:
                raise SceneError(error_lines(path, lines)) from None
            reasons[item] = lines[0]
    return points, reasons


def _row(
    stages: StageList,
    name: str,
    sets: tuple[Removed, ...],
    numbers: Mapping[Removed, int],
    reasons: Mapping[Removed, str],
) -> BudgetRow:
    found = [numbers.get(item) for item in sets]
    why = "; ".join(dict.fromkeys(reasons[item] for item in sets if item in reasons))
    return BudgetRow(name, stages.stages[name].title, Cost(*found[:2]), Cost(*found[2:]) if found[2:] else None, why)


def _label(stages: StageList, removed: Removed) -> str:
    kept = [name for name in stages.stages if name not in removed]
    gone = [name for name in stages.stages if name in removed]
    if not gone:
        return "all stages"
    return f"without {', '.join(gone)}" if len(gone) < len(kept) else f"{', '.join(kept) or 'nothing'} alone"


def as_options(settings: Mapping[str, Any]) -> str:
    """Write settings as options of a command: ``--set excess= --set photon.coherence=none``."""
    return " ".join(f"--set {quote(f'{key}={_text(value)}')}" for key, value in settings.items())


def _text(value: Any) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else _toml(value)


def _toml(value: Any) -> str:
    """Write a value as TOML, on one line."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key} = {_toml(item)}' for key, item in value.items())}}}"
    return f"[{', '.join(map(_toml, value))}]" if isinstance(value, list | tuple) else json.dumps(value)
