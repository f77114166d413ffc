"""A search problem: a scene file with [optimise], its knobs, and the scene of each design."""

import ast
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.bands import TABLE
from surveysim.scene.error_lines import error_lines
from surveysim.scene.keys import all_keys
from surveysim.scene.metrics import metric_keys
from surveysim.scene.optimise import Limit as LimitSection
from surveysim.scene.optimise import Optimise
from surveysim.scene.scene import Origin, Scene, read_scene, scene_hash, scene_of
from surveysim.scene.shipped import find_scene
from surveysim.scene.similar_names import did_you_mean
from surveysim.scene.units import file_value, shown
from surveysim.studies.optimise.expressions import key_value, names, parse, quantity_of, unit, value_of
from surveysim.studies.optimise.knobs import Knob, check_key, knob_numbers, knob_of, knob_settings

COSTS = ("detectors", "data_rate", "observing_time")  # quantities that a search can make small
QUANTITIES = (*COSTS, "field_of_view")  # that limits may bound
Places = tuple[float, ...]  # of the knobs, 0 to 1


@dataclass(frozen=True)
class Limit:
    """A bound on a quantity of each design: its expression, and lowest and highest values of the file."""

    text: str
    tree: ast.expr
    at_least: Any = None
    at_most: Any = None


@dataclass(frozen=True)
class Problem:
    """A scene file with [optimise].

    Attributes
    ----------
    scene
        The scene as it is.
    content
        Values of the file by key, with overrides.
    derived
        Expressions by the key that they give.
    """

    origin: Origin
    scene: Scene
    content: Mapping[str, Any]
    knobs: tuple[Knob, ...]
    derived: Mapping[str, ast.expr]
    limits: tuple[Limit, ...]

    @property
    def options(self) -> Optimise:
        """The section [optimise]."""
        return self.scene.optimise

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.origin.path

    @property
    def identity(self) -> str:
        """SHA-256 of everything that the path of the search depends on; more evaluations and rivals go on with it."""
        section = self.options.model_dump(exclude={"rivals", "evaluations"})
        return sha256(json.dumps([scene_hash(self.scene), section], default=str).encode()).hexdigest()

    def settings(self, places: Places) -> dict[str, Any]:
        """Values of the knobs at some places, by key."""
        return knob_settings(self.knobs, places)

    def present_places(self) -> Places | None:
        """Places of the scene as it is; None if it is outside the knobs' values."""
        numbers = knob_numbers(self.knobs, {knob.key: key_value(self.content, knob.key) for knob in self.knobs})
        if None in numbers:
            return None
        return tuple(knob.place(number) for knob, number in zip(self.knobs, numbers, strict=True))

    def places_of(self, settings: Mapping[str, Any]) -> Places:
        """Places of the knobs in the settings of a design."""
        return tuple(knob.place(knob.number_of(settings[knob.key])) for knob in self.knobs)

    def with_derived(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Add the keys that follow from the knobs; none for the scene as it is, which has no settings.

        Raises
        ------
        InputError
            For an expression without a value here.
        """
        found = dict(settings)
        for key, tree in self.derived.items() if settings else ():
            try:
                found[key] = _file_value(key, value_of(tree, self.values(found)))
            except InputError as error:
                raise InputError(f"{key}: {error}") from None
        return found

    def values(self, settings: Mapping[str, Any]) -> Callable[[str], Any]:
        """Return a function of a key that gives its value as a number or quantity; None where there is none."""

        def given(name: str) -> Any:
            value = settings.get(name)
            value = key_value(self.content, name) if value is None else value
            return None if value is None else quantity_of(value)

        return given

    def scene_at(self, settings: Mapping[str, Any]) -> Scene:
        """Return the scene of a design; raises SceneError for one that can't be run."""
        path, text = self.path, self.origin.text
        content = {key: value for key, value in self._file.items() if key != "optimise"}
        overrides = {key: value for key, value in self.origin.overrides.items() if not key.startswith("optimise.")}
        return scene_of(path, text, content, overrides | dict(settings))

    @property
    def _file(self) -> Mapping[str, Any]:
        import tomllib

        return tomllib.loads(self.origin.text)


def load_problem(path: str | Path, overrides: Mapping[str, Any] | None = None) -> Problem:
    """Read a scene file with a section [optimise], and check its knobs, derived keys and limits.

    Parameters
    ----------
    path
        Path of the file, or the name of a scene.
    overrides
        Values by dotted key, as for `load_scene`.

    Raises
    ------
    SceneError
        With one line for each error: file, key, value found, values allowed.
    """
    path = find_scene(path)
    overrides = {key: file_value(value) for key, value in (overrides or {}).items()}
    text, content = read_scene(path)
    for table, what in ((TABLE, "a camera of several bands"), ("sweep", "a sweep")):
        if table in content:
            raise SceneError(f"{path}: {table}: found {what}; a scene without [{table}] is expected by 'optimise'")
    scene = scene_of(path, text, content, overrides)
    if scene.optimise is None:
        raise SceneError(f"{path}: optimise: missing; a section [optimise] with knobs is expected")
    if scene.score is None:
        raise SceneError(f"{path}: score: missing; a search compares scores")
    origin = Origin(path.absolute(), text, overrides)
    problem, wrong = _problem(origin, scene, _with(content, overrides))
    if wrong:
        raise SceneError(error_lines(path, wrong))
    return problem


def _problem(origin: Origin, scene: Scene, content: Mapping[str, Any]) -> tuple[Problem, list[str]]:
    """Make the parts of a problem, and a line for each error."""
    wrong: list[str] = []

    def made(job: Callable[..., Any], sections: tuple[Any, ...], name: str) -> list[Any]:
        found = []
        for number, section in enumerate(sections):
            try:
                found.append(job(section, f"optimise.{name}.{number}"))
            except InputError as error:
                wrong.append(str(error))
        return found

    options, metrics = scene.optimise, (*metric_keys(scene.score.metrics), *COSTS)
    for key in options.metrics:
        if key not in metrics:
            expected = did_you_mean(key, list(metrics)) or f"one of {', '.join(metrics)} is expected"
            wrong.append(f"optimise.metrics: found {shown(key)}; {expected}")
    knobs = tuple(made(knob_of, options.knobs, "knobs"))
    derived = dict(made(_derived_of, options.derived, "derived"))
    limits = tuple(made(_limit_of, options.limits, "limits"))
    problem = Problem(origin, scene, content, knobs, derived, limits)
    known = {*(knob.key for knob in knobs), *derived}
    for number, tree in enumerate(derived.values()):
        wrong += _unknown_names(problem, tree, known, f"optimise.derived.{number}.value")
    for number, limit in enumerate(limits):
        wrong += _unknown_names(
            problem, limit.tree, known | {*metrics, *QUANTITIES}, f"optimise.limits.{number}.quantity"
        )
    return problem, wrong


def _unknown_names(problem: Problem, tree: ast.expr, known: set[str], where: str) -> Iterator[str]:
    """Yield a line for each name of an expression that is no known one, no key with a value and no unit."""
    given = problem.values({})
    for name in sorted(names(tree)):
        try:
            if name not in known and given(name) is None:
                unit(name)
        except InputError as error:
            similar = did_you_mean(name, sorted({*known, *all_keys()}))
            yield f"{where}: {f'found {shown(name)}; {similar}' if similar else error}"


def _derived_of(section: Any, where: str) -> tuple[str, ast.expr]:
    check_key(section.key, f"{where}.key")
    try:
        return section.key, parse(section.value)
    except InputError as error:
        raise InputError(f"{where}.value: {error}") from None


def _limit_of(section: LimitSection, where: str) -> Limit:
    try:
        bounds = [None if bound is None else quantity_of(bound) for bound in (section.at_least, section.at_most)]
        return Limit(section.quantity, parse(section.quantity), *bounds)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None


def _file_value(key: str, value: Any) -> Any:
    """Value as the scene file has it; whole numbers are integers where the key's values are."""
    found = _rounded(file_value(value))
    if all_keys()[key].get("type") == "integer" and isinstance(found, float):
        if found % 1:
            raise InputError(f"found {shown(found)}; an integer is expected, by round(), floor() or ceil()")
        return int(found)
    return found


def _rounded(value: Any) -> Any:
    """Round to nine digits, so that values do not depend on the order of factors."""
    if isinstance(value, float):
        return float(f"{value:.9g}")
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    if isinstance(value, str):
        return re.sub(r"\d+\.\d+(e[+-]\d+)?", lambda match: f"{float(match[0]):.9g}", value, flags=re.ASCII)
    return value


def _with(content: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a file with overrides, as nested tables."""
    from copy import deepcopy

    found = deepcopy(dict(content))
    for key, value in overrides.items():
        *sections, last = key.split(".")
        table: Any = found
        for name in sections:
            table = table.setdefault(name, {})
        table[last] = value
    return found
