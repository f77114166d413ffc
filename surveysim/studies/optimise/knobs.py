"""Knobs of a search: keys of the scene, with their values on the unit interval."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.runtime.errors import InputError
from surveysim.scene.error_lines import allowed_keys, unknown_key
from surveysim.scene.keys import all_keys
from surveysim.scene.optimise import Knob as KnobSection
from surveysim.scene.renamed_keys import renamed_line
from surveysim.scene.scene import Scene
from surveysim.scene.single_values import wrong_value
from surveysim.scene.units import shown, to_float, unit_of
from surveysim.studies.sweep.axes import numbers_of, value_text

COMMON = ("seed", "name", "title", "sweep", "optimise", "bands")  # keys that all designs have in common
DIGITS = 6  # of the value of a knob


@dataclass(frozen=True)
class Knob:
    """A key of the scene, and its values for places from 0 to 1.

    Attributes
    ----------
    low, high
        Ends of the range, in `unit`; numbers of the first and last choice where there are `choices`.
    integer
        Whether values are integers.
    log
        Whether values are spread evenly on a logarithmic scale.
    """

    key: str
    low: float
    high: float
    unit: str = ""
    log: bool = False
    integer: bool = False
    choices: tuple[Any, ...] = ()

    @property
    def continuous(self) -> bool:
        """Return whether values are neither integers nor choices."""
        return not self.integer and not self.choices

    def number(self, place: float) -> float:
        """Return the number at a place: in `unit`, or that of a choice."""
        place = min(max(float(place), 0.0), 1.0)
        if not self.continuous and not self.log:  # each integer, and each choice, has an equal part
            count = self.high - self.low + 1
            return self.low + min(np.floor(place * count), count - 1)
        ratio, width = self.high / self.low if self.log else 1.0, self.high - self.low
        found = self.low * ratio**place if self.log else self.low + place * width
        return float(round(found)) if self.integer else float(f"{found:.{DIGITS}g}")

    def value(self, place: float) -> Any:
        """Return the value at a place as a scene file has it."""
        number = self.number(place)
        if self.choices:
            return _thawed(self.choices[int(number)])
        if self.integer:
            return int(number)
        return f"{number!r} {self.unit}" if self.unit else number

    def number_of(self, value: Any) -> float | None:
        """Return the number of a value of a scene file; None for a value that is none of the knob's."""
        if self.choices:
            texts = [value_text(_thawed(item)) for item in self.choices]
            return float(texts.index(value_text(value))) if value_text(value) in texts else None
        if value is None:
            return None
        try:
            number = to_float(value, self.unit)
        except InputError:
            return None
        inside = min(self.low, self.high) * (1 - 1e-9) <= number <= max(self.low, self.high) * (1 + 1e-9)
        return number if inside else None

    def place(self, number: float) -> float:
        """Return the place of a number: the middle of its part for integers and choices."""
        if not self.continuous and not self.log:
            return (number - self.low + 0.5) / (self.high - self.low + 1)
        if self.log:
            return float(np.log(number / self.low) / np.log(self.high / self.low))
        return (number - self.low) / (self.high - self.low)

    def steps(self) -> list[float]:
        """Places of all values; none for a continuous knob."""
        if self.continuous:
            return []
        return [self.place(number) for number in np.arange(self.low, self.high + 1)]


def knob_of(section: KnobSection, where: str) -> Knob:
    """Make a knob of its section of the scene; InputError for an unknown key, and for ends that do not fit."""
    check_key(section.key, f"{where}.key")
    _check_values(section, where)
    if section.choices:
        return Knob(section.key, 0.0, len(section.choices) - 1.0, choices=section.choices)
    integer = all_keys()[section.key].get("type") == "integer"
    unit = (unit_of(section.low) or "") if isinstance(section.low, str) else ""
    ends = []
    for name, value in (("low", section.low), ("high", section.high)):
        found = numbers_of([value])
        try:
            number = float(found[0][0]) if found and not found[1] and not unit else to_float(value, unit)
        except InputError as error:
            raise InputError(f"{where}.{name}: {error}") from None
        if integer and number % 1:
            raise InputError(f"{where}.{name}: found {shown(value)}; an integer is expected")
        ends.append(number)
    low, high = ends
    if not low < high:
        raise InputError(f"{where}.high: found {shown(section.high)}; more than 'low', {section.low}, is expected")
    if section.scale == "log" and low <= 0:
        raise InputError(f"{where}.low: found {shown(section.low)}; a value above 0 is expected with scale 'log'")
    return Knob(section.key, low, high, unit, section.scale == "log", integer)


def _check_values(section: KnobSection, where: str) -> None:
    """Raise InputError for a choice that no scene can have, and for a range with two such ends."""
    for item in section.choices:
        if said := wrong_value(section.key, _thawed(item)):
            raise InputError(f"{where}.choices: {said}")
    said = "" if section.choices else wrong_value(section.key, section.low)
    if said and wrong_value(section.key, section.high):
        raise InputError(f"{where}.low: {said}")


def check_key(key: str, where: str) -> None:
    """Raise InputError unless this is a key of a scene that designs may differ in."""
    *sections, last = key.split(".")
    if sections[:1] == ["optimise"] or key in COMMON:
        raise InputError(f"{where}: found {shown(key)}, which all designs have in common; another key is expected")
    if renamed := renamed_line(key):
        raise InputError(renamed)
    if last not in allowed_keys(sections, Scene):
        raise InputError(f"{where}: found {shown(key)}: {unknown_key(key, Scene, COMMON)}")
    if key not in all_keys():
        raise InputError(f"{where}: found the section {shown(key)}; one of its keys is expected")


def knob_settings(knobs: tuple[Knob, ...], places: tuple[float, ...]) -> dict[str, Any]:
    """Values of all knobs at some places, by key."""
    return {knob.key: knob.value(place) for knob, place in zip(knobs, places, strict=True)}


def knob_numbers(knobs: tuple[Knob, ...], settings: Mapping[str, Any]) -> list[float | None]:
    """Numbers of all knobs in some settings; None where they are outside the knob's values."""
    return [knob.number_of(settings.get(knob.key)) for knob in knobs]


def _thawed(value: Any) -> Any:
    return [_thawed(item) for item in value] if isinstance(value, tuple) else value
