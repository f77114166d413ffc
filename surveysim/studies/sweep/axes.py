"""Sweeps: the table [sweep] of a scene file, parsed into axes of values and the scenes of all combinations.

Each point is the scene of the file with some keys replaced. All points have the same seed: random numbers that do not
depend on the replaced keys are common, so differences between points have smaller errors than the points.
"""

import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from hashlib import sha256
from itertools import product
from math import prod
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import InputError, SceneError
from surveysim.runtime.text_files import key_text
from surveysim.scene.bands import TABLE, band_key, common_key
from surveysim.scene.error_lines import allowed_keys, error_lines, unknown_key
from surveysim.scene.fields import LONGEST_LINE
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.scene.renamed_keys import renamed_line
from surveysim.scene.scene import Origin, Scene, read_scene, scene_hash, scene_of
from surveysim.scene.shipped import find_scene
from surveysim.scene.units import file_value, shown
from surveysim.studies.sweep.choices import METRIC, REFERENCE, check_metric, given_choices, reference_point, value_text
from surveysim.telescope.scans import samples_per_scan

MAX_POINTS = 1000
LABEL_LENGTH = 40
COMMON = ("seed", "name", "title", "sweep", "optimise")  # keys that are the same at all points

T = TypeVar("T")


@dataclass(frozen=True)
class Axis:
    """Keys of the scene that change together, and a tuple of their values (as in the file) for each step."""

    name: str
    keys: tuple[str, ...]
    values: tuple[tuple[Any, ...], ...]

    @property
    def distinguishing_keys(self) -> tuple[str, ...]:
        """Keys that distinguish the steps: the first one if its values do, else all keys whose values differ."""
        texts = [[value_text(value) for value in column] for column in zip(*self.values, strict=True)]
        if len(set(texts[0])) == len(self.values):
            return self.keys[:1]
        varying = tuple(key for key, column in zip(self.keys, texts, strict=True) if len(set(column)) > 1)
        return varying or self.keys[:1]

    @cached_property
    def labels(self) -> list[str]:
        """Value of the first key at each step, or ``key = value`` of all `distinguishing_keys`, as short text.

        Steps with equal text have their number appended.
        """
        keys = self.distinguishing_keys
        columns = [[_short(values[self.keys.index(key)]) for values in self.values] for key in keys]
        if keys == self.keys[:1]:
            texts = columns[0]
        else:
            names = _short_names(keys)
            texts = [
                ", ".join(f"{name} = {text}" for name, text in zip(names, row, strict=True))
                for row in zip(*columns, strict=True)
            ]
        seen = Counter(texts)
        return [f"{text} #{step}" if seen[text] > 1 else text for step, text in enumerate(texts)]

    def at(self, *steps: int) -> str:
        """Format steps as ``name = value or value, ...`` or ``name (key = value, ... or key = value, ...)``."""
        text = " or ".join(self.labels[step] for step in steps)
        return f"{self.name} = {text}" if self.distinguishing_keys == self.keys[:1] else f"{self.name} ({text})"


@dataclass(frozen=True)
class Point:
    """A combination of values: its `number`, its `place` on each axis, `settings` by key, and the resulting scene.

    `label` names it by its axes: ``key = value, ...``.
    """

    number: int
    place: tuple[int, ...]
    label: str
    settings: dict[str, Any]
    scene: Scene
    n_det: int
    detector_samples: int


@dataclass(frozen=True)
class Sweep:
    """A scene file with [sweep]: its axes, and the points of all combinations; the last axis varies fastest.

    `reference` is the number of the point that ratios refer to, `metric` the key of the quantity that points are
    compared by, and `origin` the file with its overrides.
    """

    path: Path
    axes: tuple[Axis, ...]
    points: tuple[Point, ...]
    origin: Origin
    reference: int = 0
    metric: str = SIGMA_KEY

    @property
    def name(self) -> str:
        """The scene's name."""
        return self.points[0].scene.name


def load_sweep(
    path: str | Path, overrides: Mapping[str, Any] | None = None, reference: int | str | None = None
) -> Sweep:
    """Read a scene file with a table [sweep], and check and prepare the scene of every point.

    Parameters
    ----------
    path
        Path of the file, or the name of a scene.
    overrides
        Values by dotted key, as for `load_scene`, of keys that are not on an axis.
    reference
        Number of the point that ratios refer to, or its values as ``key = value, ...``; by default the file's
        `sweep.reference`, else the first point.

    Raises
    ------
    SceneError
        With one line for each error: file, key, value found, values allowed, and the point unless all have the error.
    """
    path = find_scene(path)
    overrides = {key: file_value(value) for key, value in (overrides or {}).items()}
    text, content = read_scene(path)
    axes = sweep_axes(path, content, overrides)
    origin = Origin(path.absolute(), text, overrides)
    return sweep_along(axes, origin, lambda settings: scene_of(path, text, content, overrides | settings), reference)


def sweep_along(
    axes: tuple[Axis, ...],
    origin: Origin,
    scene_at: Callable[[dict[str, Any]], Scene],
    reference: int | str | None = None,
) -> Sweep:
    """Make the sweep of all combinations of values, from the scene at the settings of a point; errors as `load_sweep`.

    Parameters
    ----------
    origin
        The file with its overrides.
    reference
        As for `load_sweep`.
    """
    path = origin.path
    places = list(product(*(range(len(axis.values)) for axis in axes)))
    settings = [_settings(axes, place) for place in places]
    labels = [", ".join(axis.at(step) for axis, step in zip(axes, place, strict=True)) for place in places]

    choices = given_choices(tomllib.loads(origin.text).get("sweep", {}))
    metric = str(choices.get(METRIC, SIGMA_KEY))

    def point(number: int) -> Point:
        scene = scene_at(settings[number])
        return sweep_point(number, places[number], labels[number], settings[number], scene, metric)

    points = tuple(_of_all(path, labels, point))
    name = "sweep.reference" if reference is None else "--reference"
    given = choices.get(REFERENCE) if reference is None else reference
    try:
        chosen = reference_point(name, given, axes, points)
    except InputError as error:
        raise SceneError(f"{path}: {error}") from None
    if reference is not None and all(axis.name != REFERENCE for axis in axes):
        origin = replace(origin, overrides={**origin.overrides, f"sweep.{REFERENCE}": chosen})
    return Sweep(path, axes, points, origin, chosen, metric)


def sweep_point(
    number: int,
    place: tuple[int, ...],
    label: str,
    settings: dict[str, Any],
    scene: Scene,
    metric: str = SIGMA_KEY,
) -> Point:
    """Make a point of a scene, checked and prepared; raises SceneError for one that can't be run or compared."""
    if scene.score is None:
        raise SceneError("score: missing; scenes are compared by their scores")
    check_metric(metric, scene)
    setup = prepare(scene)
    scans = setup.observing.scans
    samples = setup.camera.n_det * scans.n_scans * samples_per_scan(scans) * scene.observations
    return Point(number, place, label, settings, scene, setup.camera.n_det, samples)


def sweep_hash(sweep: Sweep) -> str:
    """Return the SHA-256 of everything that the results depend on: scenes of the points, reference point, metric."""
    found = [*(scene_hash(point.scene) for point in sweep.points), str(sweep.reference)]
    found += [sweep.metric] * (sweep.metric != SIGMA_KEY)
    return sha256(" ".join(found).encode()).hexdigest()


def numbers_of(values: Sequence[Any]) -> tuple[np.ndarray, str] | None:
    """Convert values of the file to numbers (n,) and the unit of the first; None if they are not all numbers."""
    if all(isinstance(value, int | float) for value in values):
        found, unit = np.array(values), ""
    elif all(isinstance(value, str) for value in values):
        found, unit = _fractions(values) or _quantities(values) or (np.array([np.nan]), "")
    else:
        return None
    return (found, unit) if np.isfinite(found).all() else None


def _fractions(values: Sequence[str]) -> tuple[np.ndarray, str] | None:
    try:
        return np.array([float(Fraction(value)) for value in values]), ""
    except (ValueError, ZeroDivisionError, OverflowError):
        return None


def _quantities(values: Sequence[str]) -> tuple[np.ndarray, str] | None:
    import astropy.units as u

    try:
        found = [u.Quantity(value) for value in values]
        return np.array([float(item.to_value(found[0].unit)) for item in found]), str(found[0].unit)
    except (u.UnitConversionError, TypeError, ValueError):
        return None


# ---------------------------------------------------------------- the table [sweep]


def sweep_axes(path: Path, content: Mapping[str, Any], overrides: Mapping[str, Any]) -> tuple[Axis, ...]:
    """Parse the axes of a file; raises SceneError with a line for each error in its table."""
    table = content.get("sweep")
    if not isinstance(table, dict) or not table:
        found = "missing" if table is None else f"found {shown(table)}"
        raise SceneError(f"{path}: sweep: {found}; a table of keys with lists of values is expected")
    axes, wrong = [], []
    chosen = given_choices(table)
    for name, value in table.items():
        if name in chosen:
            continue
        try:
            axes.append(_axis(name, value, tuple(content.get(TABLE, ()))))
        except InputError as error:
            wrong.append(str(error))
    if wrong:
        raise SceneError(error_lines(path, wrong))
    if not axes:
        found = " and ".join(map(repr, chosen))
        raise SceneError(f"{path}: sweep: found {found} alone; a key with a list of values is expected")
    try:
        _check_together(axes, overrides)
    except InputError as error:
        raise SceneError(f"{path}: {error}") from None
    return tuple(axes)


def _axis(name: str, value: Any, bands: tuple[str, ...]) -> Axis:
    where = f"sweep.{key_text(name)}"
    if isinstance(value, list):
        lists = {name: value}
    elif isinstance(value, dict) and value:
        lists = value
        if not name.isprintable() or not 0 < len(name) <= LONGEST_LINE:
            raise InputError(
                f"sweep: found the axis {shown(name)}; a name in one line, of printable letters, is expected"
            )
    else:
        raise InputError(f"{where}: found {shown(value)}; a list of values, or a table of keys with lists, is expected")
    for key, items in lists.items():
        of_key = where if lists is not value else f"{where}.{key_text(key)}"
        _check_key(of_key, name, key, bands)
        if not isinstance(items, list) or not items:
            raise InputError(f"{of_key}: found {shown(items)}; a list of one or more values is expected")
    lengths = [len(items) for items in lists.values()]
    if len(set(lengths)) > 1:
        raise InputError(f"{where}: found lists of {' and '.join(map(str, lengths))} values; one length is expected")
    return Axis(name, tuple(lists), tuple(zip(*lists.values(), strict=True)))


def _check_key(where: str, axis: str, key: str, bands: tuple[str, ...]) -> None:
    """Raise an error unless this is a key, of the scene or of one of its bands, that points may differ in."""
    band, own = band_key(key)
    if band in bands and (same := common_key(own)):
        raise InputError(f"{where}: {same!r} is the same in all bands; {shown(own)} is expected")
    key = own if band in bands else key
    *sections, last = key.split(".")
    if sections[:1] in (["sweep"], ["optimise"]) or key in COMMON:
        raise InputError(f"{where}: found {shown(key)}, which all points have in common; another key is expected")
    if renamed := renamed_line(key):
        raise InputError(renamed)
    if last not in allowed_keys(sections, Scene):
        if axis != key and key in allowed_keys(axis.split("."), Scene):
            raise InputError(f'{where}: unknown key; a key with dots goes in quotes: "{axis}.{key}"')
        raise InputError(f"{where}: {unknown_key(key, Scene, COMMON)}")


def _check_together(axes: Sequence[Axis], overrides: Mapping[str, Any]) -> None:
    """Raise an error if a key appears twice, or for too many points."""
    seen: list[str] = []
    for key in (key for axis in axes for key in axis.keys):
        if other := next((other for other in seen if _overlap(key, other)), None):
            raise InputError(f"sweep: found {shown(key)} and {shown(other)}; every key on one axis is expected")
        if other := next((other for other in overrides if _overlap(key, other)), None):
            raise InputError(f"{other}: set, and on an axis of the sweep; a key that it leaves alone is expected")
        seen.append(key)
    n_points = prod(len(axis.values) for axis in axes)
    if n_points > MAX_POINTS:
        raise InputError(f"sweep: found {n_points} points; {MAX_POINTS} or less are expected")


def _overlap(key: str, other: str) -> bool:
    """Return whether two dotted keys are equal, or one is a section that contains the other."""
    return f"{key}.".startswith(f"{other}.") or f"{other}.".startswith(f"{key}.")


def _short(value: Any) -> str:
    text = value_text(value)
    return text if len(text) <= LABEL_LENGTH else f"{text[: LABEL_LENGTH - 3]}..."


def _short_names(keys: Sequence[str]) -> list[str]:
    """Last parts of dotted keys, or the whole keys if the parts are not unique."""
    last = [key.rpartition(".")[2] for key in keys]
    return last if len(set(last)) == len(last) else list(keys)


def _settings(axes: Iterable[Axis], place: tuple[int, ...]) -> dict[str, Any]:
    return {
        key: value
        for axis, step in zip(axes, place, strict=True)
        for key, value in zip(axis.keys, axis.values[step], strict=True)
    }


def _of_all(path: Path, labels: Sequence[str], job: Callable[[int], T]) -> list[T]:
    """Compute `job(number)` for each point; raises SceneError with each error once."""
    done: list[T] = []
    wrong: dict[str, list[int]] = {}
    named = path  # as the errors of scenes do
    for number in range(len(labels)):
        try:
            done.append(job(number))
        except SceneError as error:
            for line in str(error).splitlines():
                head, _, rest = line.partition(": ")
                own = Path(head).absolute() == path.absolute()
                named = Path(head) if own else named
                wrong.setdefault(rest if own else line, []).append(number)
    if wrong:
        raise SceneError(error_lines(named, [_line(line, labels, points) for line, points in wrong.items()]))
    return done


def _line(line: str, labels: Sequence[str], points: list[int]) -> str:
    if len(points) == len(labels) > 1:
        return line
    others = f" and {len(points) - 1} more" if len(points) > 1 else ""
    return f"point ({key_text(labels[points[0]])}){others}: {line}"
