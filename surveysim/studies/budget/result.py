"""Result of a budget: its points, and the costs of all stages."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from surveysim.studies.budget.costs import Measured, PairCost, StageCost, Total, pair_costs, stage_costs, total
from surveysim.studies.budget.points import WHOLE, Budget
from surveysim.studies.sweep.comparison import Comparison, actual_shares
from surveysim.studies.sweep.point_store import PointResult
from surveysim.survey.discarded_scans import competing, sweep_warnings

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from surveysim.runtime.table import Table


@dataclass(frozen=True)
class BudgetResult:
    """A finished budget; `simulated` is false if its points are forecasts only.

    Attributes
    ----------
    budget
        Stages and points.
    points
        Results of the points.
    comparison
        Their comparison with the whole scene.
    exponent
        Power of the noise power that the metric goes with, in the whole scene.
    """

    budget: Budget
    points: tuple[PointResult, ...]
    comparison: Comparison
    exponent: float
    simulated: bool
    wall_s: float
    workers: int
    engine: str

    @property
    def measured(self) -> Measured:
        """Values of the metric at the points."""
        modes = self.comparison.modes
        if not self.simulated:  # sigma(A) goes as one over the kept scans, as it does over time
            modes = np.diag([self.exponent * item.kept_error for item in self.points])
        return Measured(self.comparison.value, modes, self.exponent, self.simulated)

    @property
    def is_scored(self) -> bool:
        """True if the whole scene has a score."""
        return self.comparison.reference == WHOLE

    @property
    def costs(self) -> tuple[StageCost, ...]:
        """Costs of the stages."""
        return stage_costs(self.budget, self.measured)

    @property
    def total(self) -> Total:
        """Sums of the costs."""
        return total(self.budget, self.measured)

    @property
    def pairs(self) -> tuple[PairCost, ...]:
        """Interactions of pairs of stages, if they were asked for."""
        return pair_costs(self.budget, self.measured)

    @property
    def warnings(self) -> list[str]:
        """Lines on scans that points discard."""
        if not self.simulated:
            return []
        labels = [point.label for point in self.budget.sweep.points]
        return sweep_warnings(labels, [point.discarded for point in self.points])

    def comparable(self, numbers: Sequence[int]) -> bool:
        """Return whether points lose few scans, in similar fractions."""
        return bool(competing(actual_shares(self.points)[list(numbers)]).all())

    def table(self) -> "QTable":
        """Return a row for each stage, as budget.ecsv has it."""
        return self._table().quantities()

    def plot(self) -> "Figure":
        """Draw the survey time that each stage costs; raise ValueError without a score of the whole scene."""
        from surveysim.report.figures.budget import draw

        return draw(self)

    def _table(self) -> "Table":
        from surveysim.studies.budget.summary import budget_summary
        from surveysim.studies.budget.tables import budget_table

        return budget_table(budget_summary(self))

    def __repr__(self) -> str:
        """One line about the budget above its table."""
        kind = "runs" if self.simulated else "forecasts"
        return f"BudgetResult of {self.budget.name}: {len(self.points)} {kind}\n{self._table().text()}"

    def _repr_html_(self) -> str:
        """The table of stages."""
        return self._table().html()
