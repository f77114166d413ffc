"""Pareto front of two metrics that compete."""

from collections.abc import Callable, Sequence

import numpy as np

from surveysim.studies.optimise.evaluation import Evaluation
from surveysim.studies.optimise.search import Objective, descend_from, local_optima
from surveysim.studies.optimise.store import EvaluationStore

WEIGHTS = (0.5, 0.25, 0.75, 0.125, 0.375, 0.625, 0.875)  # of the first metric, between the two ends of the front
SUM = 1e-3  # part of the weighted sum, so that no design is as good as one that is better in one metric

Pair = Callable[[Evaluation], tuple[float, float]]  # two objectives to make small


def search_front(store: EvaluationStore, objectives: Pair) -> None:
    """Evaluate designs along the Pareto front.

    Each metric is optimised alone, which gives the ends. Between them augmented Chebyshev distances from the ideal
    point (Steuer and Choo 1983) with several weights are made small, each from the best design so far.

    Raises
    ------
    SpentError
        When the problem's number of evaluations is spent.
    """
    ends = [local_optima(store, _one(objectives, of)) for of in (0, 1)]
    if not all(ends):
        return
    first, second = (np.array(objectives(store.at(found[0].places))) for found in ends)
    ideal, span = np.minimum(first, second), np.abs(first - second)
    if not span.all():
        return  # one design is the best in both
    for weight in WEIGHTS:
        descend_from(store, _distance(objectives, ideal, span, np.array([weight, 1 - weight])))


def _one(objectives: Pair, number: int) -> Objective:
    """Return one of two objectives."""
    return lambda item: objectives(item)[number]


def _distance(objectives: Pair, ideal: np.ndarray, span: np.ndarray, weight: np.ndarray) -> Objective:
    def distance(item: Evaluation) -> float:
        apart = weight * (np.array(objectives(item)) - ideal) / span
        return float(apart.max() + SUM * apart.sum())

    return distance


def front(evaluations: Sequence[Evaluation], objectives: Pair) -> list[int]:
    """Return the numbers of the allowed designs that no other is better than in both metrics, by the first metric."""
    allowed = [number for number, item in enumerate(evaluations) if item.allowed and item.settings]
    order = sorted(allowed, key=lambda number: objectives(evaluations[number]))
    kept: list[int] = []
    for number in order:
        if not kept or objectives(evaluations[number])[1] < objectives(evaluations[kept[-1]])[1]:
            kept.append(number)
    return kept


def knee(evaluations: Sequence[Evaluation], numbers: Sequence[int], objectives: Pair) -> int:
    """Return the design of a front that is closest to the ideal point, each metric in units of its range."""
    points = np.array([objectives(evaluations[number]) for number in numbers])
    span = np.ptp(points, axis=0)
    apart = (points - points.min(axis=0)) / np.where(span > 0, span, 1.0)
    return numbers[int(np.argmin(np.linalg.norm(apart, axis=1)))]
