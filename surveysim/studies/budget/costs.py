"""Costs of stages: survey time, which adds up where noises do, and ratios of the metric.

The noise power N of a map goes as one over the survey time T, and independent noises add in N. A metric that goes as
N^p, p = 1 for sigma(A) of band powers and 1/2 for the depth of a source, is as good as before after a time in
proportion to ``value^(1/p)``. Costs are differences of that time between two points, as shares of the time of the whole
scene. Ratios of the metric do not add up.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from surveysim.studies.budget.points import WHOLE, Budget, BudgetRow, Cost
from surveysim.studies.budget.stages import CLEANING

FLAT = 1e-6  # exponent below which a metric does not depend on the noise
SMALL = 0.01  # share of the survey time below which a forecast cost is small


@dataclass(frozen=True)
class Estimate:
    """A number with its paired error; NaN for an unknown or missing one."""

    value: float
    error: float = np.nan

    @property
    def is_known(self) -> bool:
        """True if there is a value."""
        return bool(np.isfinite(self.value))


NONE = Estimate(np.nan)


@dataclass(frozen=True)
class Measured:
    """Values (n_point,) of a metric at the points of a budget, NaN for a point without a score.

    Attributes
    ----------
    values
        The metric at the points.
    modes : (n_point, n_mode)
        Responses of ln value to unit deviates that points share. Those of forecasts are independent: errors of the
        fractions of discarded scans that they predict.
    exponent
        Power p of the noise power in the value.
    simulated
        Whether the values are of runs.
    """

    values: np.ndarray
    modes: np.ndarray
    exponent: float
    simulated: bool

    def ratio(self, over: int, under: int) -> Estimate:
        """Value of one point over the value of another."""
        error = float(np.linalg.norm(self.modes[over] - self.modes[under]))
        return self._estimate(self.values[over] / self.values[under], self.values[over] / self.values[under] * error)

    def time(self, numbers: Sequence[int], factors: Sequence[int]) -> Estimate:
        """Sum of the survey times of some points with factors, as a share of the time of the whole scene.

        None for a metric that does not depend on the noise.
        """
        if abs(self.exponent) < FLAT:
            return NONE
        share = (self.values[list(numbers)] / self.values[WHOLE]) ** (1 / self.exponent)
        terms = np.array(factors) * share
        modes = (self.modes[list(numbers)] - self.modes[WHOLE]) / self.exponent
        return self._estimate(float(terms.sum()), float(np.linalg.norm(terms @ modes)))

    def _estimate(self, value: float, error: float) -> Estimate:
        if not np.isfinite(value):
            return NONE
        return Estimate(float(value), float(error))


@dataclass(frozen=True)
class StageCost:
    """Cost of a stage of a budget: `ratio` of the metric with and without it, survey `time` as a share of the whole
    scene's.

    `interaction` is the cost of its removal less that of its addition. `small` tells that its removal, or else its
    addition, costs less than the error, and by forecast less than `SMALL` if the error is. Cleaning, which others need,
    is never small.
    """

    row: BudgetRow
    removed_ratio: Estimate
    removed_time: Estimate
    added_ratio: Estimate
    added_time: Estimate
    interaction: Estimate
    small: bool


@dataclass(frozen=True)
class Total:
    """Survey time of the least scene, sums of the costs of all stages, and the rest of the whole scene's time.

    Attributes
    ----------
    least
        Time of the least scene.
    removed, added
        Time of the least scene with the costs of all removals or additions.
    together
        Time of the whole scene less `added`: the interactions of all stages.
    missing
        Stages without a cost in these sums.
    """

    least: Estimate
    removed: Estimate
    added: Estimate
    together: Estimate
    missing: tuple[str, ...]


@dataclass(frozen=True)
class PairCost:
    """Interaction of two stages: the survey time that both cost together, beyond the sum of each without the other."""

    names: tuple[str, str]
    interaction: Estimate


def stage_costs(budget: Budget, found: Measured) -> tuple[StageCost, ...]:
    """Compute the costs of all stages, in the order of the budget."""
    return tuple(_stage_cost(row, found) for row in budget.rows)


def total(budget: Budget, found: Measured) -> Total:
    """Sum the costs of all stages; no sums without a score of the least scene."""
    rows = [row for row in budget.rows if row.added is not None]
    if budget.least is None:
        return Total(NONE, NONE, NONE, NONE, tuple(row.title for row in rows))
    terms = {"removed": [(budget.least, 1)], "added": [(budget.least, 1)]}
    missing = []
    for row in rows:
        costs = {"removed": row.removed, "added": row.added}
        if not all(_is_scored(cost, found) for cost in costs.values()):
            missing.append(row.title)
            continue
        for kind, cost in costs.items():
            terms[kind] += [(cost.present, 1), (cost.absent, -1)]
    rest = [(WHOLE, 1), *((number, -factor) for number, factor in terms["added"])]
    removed, added, together = (_sum(found, items) for items in (terms["removed"], terms["added"], rest))
    return Total(found.time([budget.least], [1]), removed, added, together, tuple(missing))


def _sum(found: Measured, terms: Sequence[tuple[int, int]]) -> Estimate:
    numbers, factors = zip(*terms, strict=True)
    return found.time(numbers, factors)


def pair_costs(budget: Budget, found: Measured) -> tuple[PairCost, ...]:
    """Compute the interactions of pairs of stages, the largest first."""
    costs = [PairCost(row.names, found.time(row.points, (1, -1, -1, 1))) for row in budget.pairs]
    known = [item for item in costs if item.interaction.is_known]
    return tuple(sorted(known, key=lambda item: -abs(item.interaction.value)))


def _stage_cost(row: BudgetRow, found: Measured) -> StageCost:
    removed, added = (_cost(cost, found) for cost in (row.removed, row.added))
    interaction = NONE
    if removed[1].is_known and added[1].is_known and row.removed != row.added:
        numbers = (row.removed.present, row.removed.absent, row.added.present, row.added.absent)
        interaction = found.time(numbers, (1, -1, -1, 1))
    cost = removed[1] if removed[1].is_known else added[1]
    limit = cost.error if found.simulated else max(cost.error, SMALL)
    small = row.name != CLEANING and abs(cost.value) <= limit  # not for NaN
    return StageCost(row, *removed, *added, interaction, small)


def _cost(cost: Cost | None, found: Measured) -> tuple[Estimate, Estimate]:
    """Ratio and survey time of a stage; none without scores."""
    if cost is None or not _is_scored(cost, found):
        return NONE, NONE
    numbers = (cost.present, cost.absent)
    return found.ratio(*numbers), found.time(numbers, (1, -1))


def _is_scored(cost: Cost, found: Measured) -> bool:
    return cost.exists and bool(np.isfinite(found.values[[cost.present, cost.absent]]).all())
