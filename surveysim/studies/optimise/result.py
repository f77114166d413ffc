"""Result of an optimisation: the search by forecast, and the designs that were simulated."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from surveysim.scene.metrics import SIGMA_KEY, metric_keys
from surveysim.studies.optimise.optimum import AS_IT_IS, Found
from surveysim.studies.optimise.problem import Problem
from surveysim.studies.sweep.axes import Axis, Sweep
from surveysim.studies.sweep.result import SweepResult

if TYPE_CHECKING:
    from astropy.table import QTable
    from matplotlib.figure import Figure

    from surveysim.runtime.table import Table

FEW_PERCENT = 0.5  # scatter of a forecast, in percent, from which the result tells of it


@dataclass(frozen=True)
class OptimiseResult:
    """A finished search; `simulated` holds the best design and its rivals, None if they were forecast only."""

    problem: Problem
    found: Found
    simulated: SweepResult | None
    wall_s: float
    workers: int
    engine: str

    @property
    def best(self) -> dict[str, Any]:
        """Values of knobs and derived keys of the best design, as a scene file has them."""
        return self.found.evaluations[self.found.best].settings

    def unit(self, metric: str) -> str:
        """Return the unit of a metric, as astropy writes it."""
        return self.found.evaluations[self.found.best].units[metric]

    def lower_is_better(self, metric: str) -> bool:
        """Return whether a lower value of a metric is the better one."""
        return self.found.evaluations[self.found.best].lower[metric]

    def table(self) -> "QTable":
        """Return a row for each knob with units, as tables/optimum.ecsv has it."""
        return self._table().quantities()

    def evaluations(self) -> "QTable":
        """Return a row for each design that was forecast, with units, as tables/evaluations.ecsv has it."""
        from surveysim.studies.optimise.tables import evaluation_table

        return evaluation_table(self).quantities()

    def plot(self) -> "Figure":
        """Draw the metric along each knob, or the Pareto front of two metrics."""
        from surveysim.report.figures.optimum import draw

        return draw(self)

    def _table(self) -> "Table":
        from surveysim.studies.optimise.summary import optimum_summary
        from surveysim.studies.optimise.tables import optimum_table

        return optimum_table(optimum_summary(self))

    def __repr__(self) -> str:
        """One line about the search above the table of its knobs."""
        return (
            f"OptimiseResult of {self.problem.scene.name}: {len(self.found.evaluations)} forecasts\n"
            f"{self._table().text()}"
        )

    def _repr_html_(self) -> str:
        """The table of knobs."""
        return self._table().html()

    @property
    def warnings(self) -> list[str]:
        """Lines on a search that was cut short, on noise of the forecast, and on flags of the best design."""
        found, best = self.found, self.found.evaluations[self.found.best]
        lines = []
        if found.spent:
            most = self.problem.options.evaluations
            lines.append(f"the search ended at its {most} forecasts; more ('optimise.evaluations') may find better")
        if 100 * found.scatter > FEW_PERCENT:
            why = ", as discarded scans are predicted from a few" if best.discarded > 0 else ""
            lines.append(
                f"forecasts scatter by {100 * found.scatter:.1f} % about a smooth surface near the optimum{why}: the"
                " best design is the lowest point of the surface"
            )
        lines += [f"the forecast of the best design may be off. {sentence}" for sentence in best.flags]
        if self.simulated is not None:
            lines += self.simulated.warnings
        return lines


def designs_sweep(problem: Problem, found: Found) -> Sweep:
    """Make a sweep of the designs to simulate: one axis, whose first point, the reference, is the scene as it is.

    Points are compared by the first metric of the search that is no cost.

    Raises
    ------
    SceneError
        For a design that can't be run.
    """
    from surveysim.studies.sweep.axes import sweep_along

    designs = [item for item in found.designs if item.name != AS_IT_IS or found.evaluations[0].metrics]
    keys = list(found.evaluations[found.best].settings)
    settings = [found.evaluations[item.number].settings for item in designs]
    names = {item.name: values for item, values in zip(designs, settings, strict=True)}
    steps = tuple((name, *(_shown(problem, values, key) for key in keys)) for name, values in names.items())
    axis = Axis("design", ("design", *keys), steps)
    sweep = sweep_along((axis,), problem.origin, lambda point: problem.scene_at(names[point["design"]]), 0)
    known = metric_keys(problem.scene.score.metrics)
    return replace(sweep, metric=next((key for key in problem.options.metrics if key in known), SIGMA_KEY))


def _shown(problem: Problem, settings: dict[str, Any], key: str) -> Any:
    """Value of a key of a design, or of the file for the scene as it is."""
    from surveysim.studies.optimise.expressions import key_value

    value = settings.get(key, key_value(problem.content, key))
    return "default" if value is None else value
