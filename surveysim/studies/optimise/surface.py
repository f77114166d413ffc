"""Smooth surface through the designs near an optimum: forecasts have noise of their own, by the pilot of kept scans."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from surveysim.studies.optimise.problem import Places
from surveysim.studies.optimise.search import Search

NEAR = 0.1  # ln of the metric over its lowest value, up to which designs are fitted
EDGE = 1e-6  # of a knob, by the rounding of its values
SPARE = 3  # designs beyond the number of coefficients
STARTS = 20  # of the search for the lowest point of a surface
SEED = 0


@dataclass(frozen=True)
class Surface:
    """Polynomial of the objective in the continuous knobs, all others fixed.

    All terms up to the second order, and cubes of each knob.

    Attributes
    ----------
    best
        Places of the design that it was fitted about.
    free
        Numbers of the continuous knobs.
    coefficients : (n_term,)
    low, high : (n_free,)
        Box of the designs that were fitted.
    designs
        Number of these.
    scatter
        Standard deviation of the objective about the surface.
    """

    best: Places
    free: tuple[int, ...]
    coefficients: np.ndarray
    low: np.ndarray
    high: np.ndarray
    designs: int
    scatter: float

    def at(self, places: np.ndarray) -> np.ndarray:
        """Evaluate the surface at places (n, n_free) of the continuous knobs."""
        return _terms(places - np.array([self.best[number] for number in self.free])) @ self.coefficients

    def lowest(self) -> Places:
        """Return the places of the lowest point in the box."""
        from scipy.optimize import minimize

        rng, box = np.random.default_rng(SEED), list(zip(self.low, self.high, strict=True))
        starts = [
            [self.best[number] for number in self.free],
            *rng.uniform(self.low, self.high, (STARTS, len(self.free))),
        ]
        found = [
            minimize(lambda part: self.at(part[None])[0], start, method="L-BFGS-B", bounds=box) for start in starts
        ]
        return self.moved(min(found, key=lambda item: item.fun).x)

    def holds(self, places: Places) -> bool:
        """Return whether a design lies in the box, with the same integers and choices."""
        part = np.array([places[number] for number in self.free])
        same = all(place == self.best[number] for number, place in enumerate(places) if number not in self.free)
        return same and bool(((part >= self.low) & (part <= self.high)).all())

    def moved(self, part: Sequence[float] | np.ndarray) -> Places:
        """Return the fitted design with other places of the continuous knobs."""
        places = list(self.best)
        for number, place in zip(self.free, part, strict=True):
            places[number] = float(place)
        return tuple(places)


def _terms(offset: np.ndarray) -> np.ndarray:
    """Terms (n, n_term) of the polynomial at offsets (n, n_free)."""
    n = range(offset.shape[1])
    second = [offset[:, i] * offset[:, j] for i, j in combinations_with_replacement(n, 2)]
    return np.stack([np.ones(len(offset)), *offset.T, *second, *offset.T**3], axis=1)


def fit_surface(search: Search, best: Places, box: Mapping[int, tuple[float, float]]) -> Surface | None:
    """Fit a surface to the allowed designs near the best one; None where they are too few.

    `box` has the ends of each continuous knob, by number, between which the metric is near the best.
    """
    if not box:
        return None
    points, values = _near(search, best, box)
    terms = _terms(points - np.array([best[number] for number in box]))
    if len(points) < terms.shape[1] + SPARE or not np.ptp(points, axis=0).all():
        return None
    coefficients, _, rank, _ = np.linalg.lstsq(terms, values, rcond=None)
    if rank < terms.shape[1]:
        return None
    scatter = math.sqrt(np.sum((values - terms @ coefficients) ** 2) / (len(points) - rank))
    return Surface(best, tuple(box), coefficients, points.min(axis=0), points.max(axis=0), len(points), scatter)


def _near(search: Search, best: Places, box: Mapping[int, tuple[float, float]]) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, n_free) and objectives (n,) of the allowed designs in a box whose metric is near the best."""
    top, points, values = search.allowed_value(best) + NEAR, [], []
    for item in search.store.evaluations:
        if not item.allowed or not item.settings or search.objective(item) > top:
            continue
        places = search.problem.places_of(item.settings)
        inside = all(low - EDGE <= places[number] <= high + EDGE for number, (low, high) in box.items())
        if inside and all(place == best[number] for number, place in enumerate(places) if number not in box):
            points.append([places[number] for number in box])
            values.append(search.objective(item))
    return np.array(points).reshape(-1, len(box)), np.array(values)
