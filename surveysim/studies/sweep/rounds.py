"""Rounds of a sweep with a target error: observations go where the ranking is open, until the best point is known.

All points run to the end of a first round. Rounds end at fixed numbers of observations, each about twice the one
before. After each, the points that may still be the best go on, among them any that stopped before. Decisions depend on
results alone, so they are the same on any machine. Points that stopped share their observations with the others; errors
of ratios allow for these and only these (`surveysim.survey.error_modes.error_modes`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from surveysim.results.stopping import FEWEST, may_end
from surveysim.runtime.errors import InputError
from surveysim.studies.sweep.axes import Point, Sweep
from surveysim.studies.sweep.comparison import Comparison
from surveysim.studies.sweep.point_run import Stage
from surveysim.studies.sweep.point_store import PointResult

CONFIDENCE = 0.95  # by default
Run = Callable[[Sequence[Stage], bool], list[PointResult]]  # of stages, the first round or a later one
Compare = Callable[[tuple[PointResult, ...]], Comparison]


@dataclass(frozen=True)
class SweepLimits:
    """Criteria that end a sweep before its last observation.

    Parameters
    ----------
    target_error : float
        Error of the ratio of each point that may be the best to the best one.
    confidence : float
        Probability of the best point.
    """

    target_error: float
    confidence: float = CONFIDENCE

    def __post_init__(self) -> None:
        """Raise InputError for an error that is not between 0 and 1, or a confidence that is not from 0.5 to 1."""
        if not 0 < self.target_error < 1:
            raise InputError(f"target error: found {self.target_error:g}; more than 0 and less than 100 % is expected")
        if not 0.5 <= self.confidence < 1:
            raise InputError(f"confidence: found {self.confidence:g}; 50 % or more and less than 100 % is expected")


@dataclass(frozen=True)
class Rounds:
    """Rounds of a finished sweep.

    `ends` are the numbers of observations at their ends. `reason` is "confidence" if the best point is known, "target"
    if the ratios of the points that may be the best are, and "all" if these have all their observations.
    """

    limits: SweepLimits
    ends: tuple[int, ...]
    reason: str


def round_ends(points: Sequence[Point]) -> tuple[int, ...]:
    """Return the numbers of observations at the ends of rounds: 32, 64, 128, ..., and the largest of all points.

    Early ones are left out if signal simulations are too few there.
    """
    last, ends, end = max(point.scene.observations for point in points), [], FEWEST
    while end < last:
        if all(end >= point.scene.observations or may_end(point.scene, end) for point in points):
            ends.append(end)
        end *= 2
    return (*ends, last)


def run_rounds(sweep: Sweep, limits: SweepLimits, run: Run, compare: Compare) -> tuple[tuple[PointResult, ...], Rounds]:
    """Run a sweep in rounds, with functions that run stages of points and compare results."""
    ends, found = round_ends(sweep.points), dict[int, PointResult]()
    going, reason = tuple(point.number for point in sweep.points), ""
    for number, end in enumerate(ends):
        stages = [_stage(sweep.points[point], end) for point in going]
        stages = [item for item in stages if _done(found, item.point) < item.observations]
        found |= zip((item.point.number for item in stages), run(stages, number > 0), strict=True)
        points = tuple(found[point.number] for point in sweep.points)
        reason, going = decision(compare(points), limits, looks=len(ends), flips=_fewest_flips(points))
        if not reason and all(found[point].observations == sweep.points[point].scene.observations for point in going):
            reason = "all"
        if reason:
            break
    return points, Rounds(limits, ends[: number + 1], reason)


def decision(comparison: Comparison, limits: SweepLimits, *, looks: int, flips: int) -> tuple[str, tuple[int, ...]]:
    """Return the reason to stop, empty to go on, and the numbers of the points that go on.

    A best point that is known at one of several looks may be the wrong one at each. The chance of an error is therefore
    shared by the looks (Bonferroni): each asks for a confidence of ``1 - (1 - confidence) / looks``. Errors come from
    the scatter of few sign-flipped co-adds, so the distance that this takes is that of Student's t. A point goes on
    unless its own probability is below an equal share of the chance among the points. If no point competes, all go on.

    Parameters
    ----------
    looks
        Number of rounds, at most.
    flips
        Number of sign-flipped co-adds of each point.
    """
    from scipy.special import ndtr, stdtrit

    probability, competing = comparison.best_probability, np.flatnonzero(comparison.competing)
    if len(competing) == 0:
        return "", tuple(range(len(probability)))
    chance = 1 - ndtr(stdtrit(max(1, flips - 1), 1 - (1 - limits.confidence) / looks))
    best = competing[np.argmax(probability[competing])]
    going = competing[probability[competing] >= chance / len(competing)]
    if probability[best] >= 1 - chance:
        return "confidence", tuple(going.tolist())
    errors = np.linalg.norm(comparison.modes[going] - comparison.modes[best], axis=1)
    return "target" if (errors <= limits.target_error).all() else "", tuple(going.tolist())


def _fewest_flips(points: tuple[PointResult, ...]) -> int:
    return min((len(item.noise_psds) for point in points for item in point.scores.values()), default=1)


def _stage(point: Point, end: int) -> Stage:
    return Stage(point, min(end, point.scene.observations))


def _done(found: dict[int, PointResult], point: Point) -> int:
    return found[point.number].observations if point.number in found else 0
