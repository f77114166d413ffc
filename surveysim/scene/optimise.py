"""Section [optimise] with its knobs, derived keys and limits: a search for the best design."""

import math
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from surveysim.scene.fields import Line, of_file, whole
from surveysim.scene.section import Section
from surveysim.scene.units import shown

MOST_KNOBS = 6
MOST_CHOICES = 12


def _end(value: object) -> object:
    if not isinstance(value, int | float | str | None):
        raise ValueError(f"found {shown(value)}; a number, or a quantity in quotes, is expected")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"found {shown(value)}; a finite number is expected")
    return value


def _frozen(value: object) -> object:
    """Make tuples of lists, as a scene is hashable."""
    if not isinstance(value, int | float | str | list | tuple):
        raise ValueError(f"found {shown(value)}; a number, a text or a list of these is expected")
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


End = Annotated[int | float | str | None, BeforeValidator(_end), of_file(["number", "string"])]
Choices = Annotated[
    tuple[Any, ...],
    BeforeValidator(_frozen),
    Field(max_length=MOST_CHOICES),
    of_file("array", items={"type": ["number", "string", "array"]}, default=[]),
]


class Knob(Section):
    """A key of the scene that the search varies: a range of numbers, or a list of choices."""

    key: Line
    """Dotted key of the scene. A key whose values are integers is varied in integers."""
    low: End = None
    """Lowest value. Required without `choices`."""
    high: End = None
    """Highest value. Required without `choices`."""
    scale: Literal["linear", "log"] = "linear"
    """Scale on which values are spread evenly."""
    choices: Choices = ()
    """Values to choose from, such as cleaning algorithms. Alternative: `low` and `high`."""

    @model_validator(mode="after")
    def _range_or_choices(self) -> Self:
        given = [name for name in ("low", "high") if getattr(self, name) is not None]
        if self.choices and given:
            raise ValueError(f"{given[0]}: found together with 'choices'; a range or choices are expected")
        if not self.choices and len(given) < 2:
            raise ValueError("low: 'low' and 'high', or 'choices', are expected")
        if self.choices and len(set(self.choices)) < 2:
            raise ValueError(f"choices: found {shown(list(self.choices))}; two or more different values are expected")
        return self


class Derived(Section):
    """A key of the scene that follows from the knobs. Later ones may use earlier ones."""

    key: Line
    """Dotted key of the scene."""
    value: Line
    """Expression of keys of the scene, numbers and units, such as "60 * arcmin / scan.speed"."""


class Limit(Section):
    """A bound on a quantity of each design."""

    quantity: Line
    """Expression as in `[[optimise.derived]]`, that may also use `detectors`, `field_of_view`, `data_rate` (samples of
    all detectors in a time, in Hz), `observing_time` (of the survey, with turnarounds), and the keys of metrics."""
    at_least: End = None
    """Lowest value allowed, with a unit if the quantity has one."""
    at_most: End = None
    """Highest value allowed, with a unit if the quantity has one, such as "4000 Hz" for a data rate."""

    @model_validator(mode="after")
    def _has_a_bound(self) -> Self:
        if self.at_least is None and self.at_most is None:
            raise ValueError("at_most: 'at_least' or 'at_most' is expected")
        return self


class Optimise(Section):
    """Search for the best design, by `surveysim optimise`. Other commands leave it out."""

    metrics: Annotated[tuple[Line, ...], Field(min_length=1, max_length=2)] = ("flat_band_power.sigma",)
    """Keys of one metric to improve, or of two that compete: those of the score, such as "flat_band_power.sigma", or
    the costs `detectors`, `data_rate` and `observing_time`."""
    evaluations: Annotated[int, *whole(10, 100_000)] = 400
    """Most forecasts of the search."""
    rivals: Annotated[int, *whole(0, 20)] = 4
    """Most designs to simulate beside the best one."""
    knobs: Annotated[tuple[Knob, ...], Field(min_length=1, max_length=MOST_KNOBS)]
    derived: tuple[Derived, ...] = ()
    limits: tuple[Limit, ...] = ()

    @model_validator(mode="after")
    def _each_key_once(self) -> Self:
        keys = [item.key for item in self.knobs] + [item.key for item in self.derived]
        for name, found in (("knobs", keys), ("metrics", self.metrics)):
            if repeated := [key for key in found if found.count(key) > 1]:
                raise ValueError(f"{name}: found {repeated[0]!r} more than once; every key once is expected")
        return self
