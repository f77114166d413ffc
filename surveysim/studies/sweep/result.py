"""Result of a sweep: its points, their comparison, and all pairs of points."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.comparison import Comparison, actual_shares
from surveysim.studies.sweep.point_store import PointResult
from surveysim.studies.sweep.rounds import Rounds
from surveysim.survey.discarded_scans import competing, sweep_warnings, why_withheld

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from surveysim.runtime.table import Table

MOST_PAIRED = 100  # points with a score, every pair of which is compared

FORECAST_WEATHER = (
    "Forecasts of a sweep are for the weather that the seed draws; a run and the forecast of one scene are for all"
    " weather."
)
ESTIMATES = {  # kinds of sigma(A)
    "controlled": "has the forecast as control variate, which removes the chance of the weather sample",
    "plain": "is for the weather drawn, which is common to all points",
}


@dataclass(frozen=True)
class Pair:
    """sigma(A) of `point` over sigma(A) of `other`, with its paired error and the error of independent runs.

    A pair is `comparable` if both lose few scans, in similar fractions (`SweepResult.comparable`).
    """

    point: int
    other: int
    ratio: float
    paired_error: float
    independent_error: float
    comparable: bool


@dataclass(frozen=True)
class SweepResult:
    """A finished sweep; `simulated` is false if its points are forecasts only, `rounds` are those of a target error."""

    sweep: Sweep
    points: tuple[PointResult, ...]
    comparison: Comparison
    simulated: bool
    wall_s: float
    workers: int
    engine: str
    rounds: Rounds | None

    def table(self) -> "QTable":
        """Return a row for each point with units, as sweep.ecsv has it."""
        return self._table().quantities()

    def plot(self) -> "Figure":
        """Draw sigma(A) of all points and their ratios to the reference point; raise ValueError without a score."""
        from surveysim.report.figures.sweep import draw

        if not self.comparison.best:
            raise ValueError("sweep: found no point with a score; one or more is expected")
        return draw(self)

    def _table(self) -> "Table":
        from surveysim.studies.sweep.summary import sweep_summary
        from surveysim.studies.sweep.tables import sweep_table

        return sweep_table(sweep_summary(self, ()))

    def __repr__(self) -> str:
        """One line about the sweep above the table of its first points."""
        kind = "runs" if self.simulated else "forecasts"
        return f"SweepResult of {self.sweep.name}: {len(self.points)} {kind}\n{self._table().text()}"

    def _repr_html_(self) -> str:
        """The table of points."""
        return self._table().html()

    @property
    def estimate(self) -> str:
        """Kind of the estimates of all points: "controlled" or "plain"; empty without a score."""
        scored = [item for point in self.points for item in point.scores.values()]
        return "" if not scored else "plain" if scored[0].control is None else "controlled"

    @property
    def warnings(self) -> list[str]:
        """Lines on discarded scans, and on a reference point without a score.

        Predicted fractions of discarded scans are not accurate enough for this: the flags of a forecast tell of them.
        """
        labels = [point.label for point in self.sweep.points]
        found = sweep_warnings(labels, [point.discarded for point in self.points]) if self.simulated else []
        reference = self.comparison.reference
        if self.sweep.reference not in (0, reference):
            other = "" if reference is None else f"; ratios are to {labels[reference]}"
            found.append(f"the reference point that was chosen, {labels[self.sweep.reference]}, has no score{other}")
        return found

    def comparable(self, point: int, other: int) -> bool:
        """Return whether two points lose few scans, in similar fractions."""
        return bool(competing(actual_shares(self.points)[[point, other]]).all())

    def withheld(self, number: int) -> str:
        """Return the reason why a point with a score has no probability of being the best; empty for other points."""
        comparison = self.comparison
        scored = np.isfinite(comparison.ratio)
        if not self.simulated or comparison.competing[number] or not scored[number]:
            return ""
        if not np.isfinite(comparison.modes[number]).all():
            return "its error is unknown, as there are too few observations"
        if scored.sum() == 1:
            return "no other point has a score"
        shares = actual_shares(self.points)
        return why_withheld(float(shares[number]), float(shares[scored].min()))


def pairs(result: SweepResult) -> list[Pair]:
    """Pair each point with a score with every one before it; no pairs for more than `MOST_PAIRED` such points."""
    sigma = result.comparison.value
    scored = [int(number) for number in np.flatnonzero(np.isfinite(sigma))]
    if not result.simulated or len(scored) > MOST_PAIRED:
        return []
    return [_pair(result, point, other) for place, point in enumerate(scored) for other in scored[:place]]


def _pair(result: SweepResult, point: int, other: int) -> Pair:
    comparison = result.comparison
    sigma, error, modes = comparison.value, comparison.error, comparison.modes
    ratio = float(sigma[point] / sigma[other])
    paired = ratio * float(np.linalg.norm(modes[point] - modes[other]))
    apart = ratio * float(np.hypot(error[point] / sigma[point], error[other] / sigma[other]))
    return Pair(point, other, ratio, paired, apart, result.comparable(point, other))
