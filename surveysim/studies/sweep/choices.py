"""Choices in the table [sweep] that are no axes: the reference point, and the quantity that points are compared by."""

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.metrics import metric_keys
from surveysim.scene.scene import Scene
from surveysim.scene.units import shown

if TYPE_CHECKING:
    from surveysim.studies.sweep.axes import Axis, Point

REFERENCE, METRIC = "reference", "metric"
CHOICES = (REFERENCE, METRIC)  # no axes if their values are numbers or texts


def value_text(value: Any) -> str:
    """Format a value of the file: quantities as written, steps of cleaning joined with a plus."""
    if isinstance(value, list) and value and all(isinstance(item, str) for item in value):
        return "+".join(value)
    return value if isinstance(value, str) else repr(value)


def given_choices(table: Mapping[str, Any]) -> dict[str, int | str]:
    """Choices in the table [sweep]: its keys of these names that are no axes."""
    return {name: table[name] for name in CHOICES if isinstance(table.get(name), int | str)}


def check_metric(key: int | str, scene: Scene) -> None:
    """Raise SceneError for a quantity that the metrics of a scene do not have."""
    known = metric_keys(scene.score.metrics)
    if key not in known:
        raise SceneError(f"sweep.metric: found {shown(key)}; one of {', '.join(known)} is expected")


def reference_point(name: str, given: int | str | None, axes: "Sequence[Axis]", points: "Sequence[Point]") -> int:
    """Number of the reference point, by default the first; raises an error unless the text identifies one point."""
    if isinstance(given, bool):
        raise InputError(f"{name}: found {shown(given)}; the number of a point, or its values, is expected")
    if given is None or isinstance(given, int):
        if not 0 <= (given or 0) < len(points):
            raise InputError(f"{name}: found {given}; the number of a point, 0 to {len(points) - 1}, is expected")
        return given or 0
    found = [point.number for point in points if _is_named(given, point, axes)]
    if len(found) != 1:
        others = f"that names {len(found)} points" if found else "that names no point"
        raise InputError(f"{name}: found {given!r}, {others}; as in {points[0].label!r}, one is expected")
    return found[0]


def _is_named(text: str, point: "Point", axes: "Sequence[Axis]") -> bool:
    """Return whether a text consists of ``key = value`` of some keys or axes of a point."""
    own = [axis.at(step) for axis, step in zip(axes, point.place, strict=True)]
    own += [f"{key} = {value_text(value)}" for key, value in point.settings.items()]
    left = re.sub(r"\s*=\s*", " = ", text)
    for part in sorted(own, key=len, reverse=True):
        left = left.replace(part, "", 1)
    return bool(text.strip()) and not left.strip(" ,")
