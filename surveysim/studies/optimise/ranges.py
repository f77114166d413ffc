"""Flatness of an optimum: the metric along each knob, and the range in which it is within 1 % of the optimum."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surveysim.studies.optimise.knobs import Knob
from surveysim.studies.optimise.problem import Places
from surveysim.studies.optimise.search import Search
from surveysim.studies.optimise.surface import NEAR, Surface, fit_surface

TOLERANCE = 0.01  # of the metric
SLICE = 9  # designs along a whole knob, and along its part near the optimum
DOUBT = 3.0  # scatters by which the lowest point of a surface may lie above the best design
EQUAL = 1e-4  # of ln of the metric
FINE = 501  # places of a surface along a knob


@dataclass(frozen=True)
class KnobRange:
    """The metric along one knob, all others at the optimum.

    Attributes
    ----------
    places, values : (n,)
        Places of the knob, and the objective, infinite for designs that are not allowed.
    curve : (2, m)
        Places and objective of the smooth surface along the knob; none without a surface.
    low, high
        Ends of the range within 1 % of the optimum, as places. A choice has the optimum alone.
    ends
        Reasons of both ends: "1 %", the "range" of the knob, or a "limit".
    """

    places: np.ndarray
    values: np.ndarray
    curve: np.ndarray
    low: float
    high: float
    ends: tuple[str, str]


@dataclass(frozen=True)
class Flatness:
    """An optimum, smoothed over the noise of the forecast, and the range of each knob about it.

    Attributes
    ----------
    best
        Places of the optimum.
    surface
        Smooth surface through the designs near the optimum; None where these are too few.
    """

    best: Places
    ranges: tuple[KnobRange, ...]
    surface: Surface | None


def flatness(search: Search, best: Places) -> Flatness:
    """Evaluate designs along each knob, and fit a surface to all designs near the best one.

    The optimum is the lowest point of the surface, if that is allowed.

    Raises
    ------
    SpentError
        When the problem's number of evaluations is spent.
    """
    slices = [_slice(search, best, number) for number in range(len(search.problem.knobs))]
    places = [item for item, _ in slices]
    surface = fit_surface(search, best, {number: box for number, (_, box) in enumerate(slices) if box})
    if surface is not None:
        lowest = search.settled(surface.lowest())
        if search.allowed_value(lowest) < search.allowed_value(best) + DOUBT * surface.scatter + EQUAL:
            best = lowest
    ranges = tuple(_range(search, best, number, found, surface) for number, found in enumerate(places))
    return Flatness(best, ranges, surface)


def _moved(best: Places, number: int, place: float) -> Places:
    return (*best[:number], place, *best[number + 1 :])


def _slice(search: Search, best: Places, number: int) -> tuple[np.ndarray, tuple[float, float] | None]:
    """Evaluate designs along a knob, denser near the optimum.

    Returns all places, sorted, and the ends of the part near the optimum for a continuous knob.
    """
    knob = search.problem.knobs[number]
    places = np.array(knob.steps() or np.linspace(0, 1, SLICE))
    if len(places) > SLICE and not knob.choices:
        places = places[_around(places, best[number])]
    places = np.unique([*places, best[number]])
    search.store.all_at(_moved(best, number, place) for place in places.tolist())
    if not knob.continuous:
        return places, None
    values = np.array([search.allowed_value(_moved(best, number, place)) for place in places])
    low, high = _crossings(places, values, best[number], search.allowed_value(best) + NEAR)
    near = np.linspace(low, high, SLICE)
    search.store.all_at(_moved(best, number, place) for place in near.tolist())
    return np.unique([*places, *near]), (low, high)


def _around(places: np.ndarray, best: float) -> np.ndarray:
    """Numbers of the neighbours of the best integer, and of others spread over the range."""
    middle = int(np.argmin(np.abs(places - best)))
    near = np.arange(middle - 2, middle + 3)
    spread = np.linspace(0, len(places) - 1, SLICE - 3).round().astype(int)
    return np.unique(np.clip(np.concatenate([near, spread]), 0, len(places) - 1))


def _crossings(places: np.ndarray, values: np.ndarray, best: float, top: float) -> tuple[float, float]:
    """Places below and above the best one where the objective, interpolated, crosses the top; else the last ones."""
    ends = []
    for side in (-1, 1):
        at, before = best, -math.inf
        for place in sorted(places[(places - best) * side >= 0], key=lambda item: side * item):
            value = values[places == place][0]
            if value > top:
                share = (top - before) / (value - before) if math.isfinite(value - before) else 0.5
                at += share * (place - at)
                break
            at, before = float(place), value
        ends.append(float(at))
    return ends[0], ends[1]


def _range(search: Search, best: Places, number: int, places: np.ndarray, surface: Surface | None) -> KnobRange:
    knob, at = search.problem.knobs[number], best[number]
    places = np.unique([*places, at])
    values = np.array([search.allowed_value(_moved(best, number, place)) for place in places.tolist()])
    curve = np.zeros((2, 0)) if surface is None or not knob.continuous else _curve(surface, best, number)
    if knob.choices:
        return KnobRange(places, values, curve, at, at, ("range", "range"))
    if curve.size:
        there = curve[0]
        low, high = _crossings(there, curve[1], at, _value_at(curve, at) + math.log1p(TOLERANCE))
    else:
        there, top = places[np.isfinite(values)], search.allowed_value(best) + math.log1p(TOLERANCE)
        low, high = _crossings(places, values, at, top) if knob.continuous else _whole_ends(places, values, at, top)
    ends = _reason(knob, low, -1, there), _reason(knob, high, 1, there)
    return KnobRange(places, values, curve, low, high, ends)


def _value_at(curve: np.ndarray, place: float) -> float:
    """Value of a curve (2, n) at one of its places."""
    return float(curve[1][np.argmin(np.abs(curve[0] - place))])


def _whole_ends(places: np.ndarray, values: np.ndarray, best: float, top: float) -> tuple[float, float]:
    """Outermost integers that are reached without one above the top."""
    inside, at = values <= top, int(np.argmin(np.abs(places - best)))
    low = at - int(np.argmin([*inside[: at + 1][::-1], False])) + 1
    high = at + int(np.argmin([*inside[at:], False])) - 1
    return float(places[low]), float(places[high])


def _reason(knob: Knob, end: float, side: int, places: np.ndarray) -> str:
    """Reason of an end: a worse design beyond it, the end of the knob's range, or the last design that is allowed."""
    edge = 1 / (2 * FINE)
    if ((places - end) * side > edge).any():
        return "1 %"
    return "range" if abs(end - (0, 1)[side > 0]) < edge or knob.number(end) in (knob.low, knob.high) else "limit"


def _curve(surface: Surface, best: Places, number: int) -> np.ndarray:
    """Places and values (2, m) of a surface along one knob, within the box of the designs that were fitted."""
    axis = surface.free.index(number)
    places = np.unique([*np.linspace(surface.low[axis], surface.high[axis], FINE), best[number]])
    points = np.repeat([[best[item] for item in surface.free]], len(places), axis=0)
    points[:, axis] = places
    return np.array([places, surface.at(points)])


def places_of_ends(best: Places, ranges: Sequence[KnobRange]) -> list[tuple[int, str, Places]]:
    """Number of the knob, "low" or "high", and places of the design at each end of the ranges."""
    return [
        (number, name, _moved(best, number, end))
        for number, item in enumerate(ranges)
        for name, end in (("low", item.low), ("high", item.high))
        if end != best[number]
    ]
