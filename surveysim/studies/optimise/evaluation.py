"""Forecast of one design: metrics, quantities that limits bound, and reasons why it is not allowed."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from surveysim.forecasting.forecast import Forecast, forecast
from surveysim.metrics.map_noise import Quantity, noise_of_forecast
from surveysim.metrics.registry import metric_functions
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup, prepare
from surveysim.results.control_variate import weather_factors
from surveysim.runtime.errors import InputError, NotForecastableError
from surveysim.scene.metrics import metric_keys
from surveysim.studies.actual_data import actual_alone
from surveysim.studies.optimise.expressions import names, value_of
from surveysim.studies.optimise.problem import Limit, Problem

BEYOND = 0.5  # excess over a limit, as a fraction, from which a design is not forecast
EQUAL = 1e-9
_UNITS = {"detectors": "", "data_rate": "Hz", "observing_time": "h"}


@dataclass(frozen=True)
class Evaluation:
    """Forecast of one design.

    Attributes
    ----------
    settings
        Values of knobs and derived keys; none for the scene as it is.
    metrics
        Metrics of the actual data by key; none if there is no forecast, for the `reason`.
    units, lower
        Unit of each metric, and whether a lower value is the better one.
    margins
        For each bound, ln of the bound over the quantity (or the inverse): 0 or more is allowed.
    discarded
        Predicted fraction of discarded scans; NaN if unknown.
    flags
        Reasons why the forecast may be off.
    """

    settings: dict[str, Any]
    metrics: dict[str, float] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    lower: dict[str, bool] = field(default_factory=dict)
    margins: tuple[float, ...] = ()
    discarded: float = math.nan
    flags: tuple[str, ...] = ()
    reason: str = ""

    @property
    def allowed(self) -> bool:
        """Return whether the design has a forecast and is within all limits."""
        return bool(self.metrics) and all(margin >= -EQUAL for margin in self.margins)


@dataclass(frozen=True)
class EvaluationJob:
    """Forecast designs of a problem, in any process."""

    problem: Problem

    def __call__(self, settings: dict[str, Any]) -> Evaluation:
        """Forecast the design of some values of the knobs; a refused design has the reason."""
        import astropy.units as u

        problem, found = self.problem, dict(settings)
        try:
            found = problem.with_derived(settings)
            setup = prepare(actual_alone(problem.scene_at(found)))
            margins = _margins(problem, found, quantities(setup))
            if settings and min(margins, default=0.0) < -math.log1p(BEYOND):
                return Evaluation(found, margins=margins, reason="beyond a limit")
            expected = forecast(setup)
            told = metric_quantities(setup, expected) | costs(setup)
            _check_values(problem, told)
            metrics = {key: item.value for key, item in told.items()}
            computed = {key: u.Quantity(item.value, item.unit) for key, item in told.items()}
            margins = _margins(problem, found, computed | quantities(setup))
        except InputError as error:
            return Evaluation(found, reason=_first_line(error, problem))
        of = expected.scores[ACTUAL]
        return Evaluation(
            found,
            metrics=metrics,
            units={key: item.unit for key, item in told.items()},
            lower={key: item.lower_is_better for key, item in told.items()},
            margins=margins,
            discarded=of.kept.discarded if math.isfinite(of.kept.error) else math.nan,
            flags=tuple(effect.sentence for effect in of.effects if effect.flagged),
        )


def _check_values(problem: Problem, found: Mapping[str, Quantity]) -> None:
    """Raise NotForecastableError for a metric of the search without a value."""
    for key in problem.options.metrics:
        if not 0 < found[key].value < math.inf:
            raise NotForecastableError(f"{key}: {found[key].note or f'found {found[key].value:g}'}")


def _first_line(error: InputError, problem: Problem) -> str:
    lines = str(error).splitlines()
    return lines[0].removeprefix(f"{problem.path}: ") if lines else type(error).__name__


def metric_quantities(setup: Setup, expected: Forecast) -> dict[str, Quantity]:
    """Metrics of the actual data by key: over all weather, as a run quotes them, if that can be forecast."""
    noise = noise_of_forecast(setup, expected.scores[ACTUAL], weather_factors(setup).get(ACTUAL, 1.0))
    functions = metric_functions(setup.scene.score)
    return {f"{name}.{item.name}": item for name, function in functions.items() for item in function(noise)}


def costs(setup: Setup) -> dict[str, Quantity]:
    """Costs of a design, which a search can make small as a metric."""
    found = quantities(setup)
    return {
        name: Quantity(name, float(found[name].to_value(unit) if unit else found[name]), unit)
        for name, unit in _UNITS.items()
    }


def quantities(setup: Setup) -> dict[str, Any]:
    """Quantities of a design that limits may bound, by name."""
    import astropy.units as u

    scans, plane = setup.observing.scans, setup.camera.focal_plane
    each = scans.n_scans * (setup.scene.scan.duration_s + setup.scene.scan.turnaround_s)
    return {
        "detectors": float(setup.camera.n_det),
        "field_of_view": u.Quantity(2 * float(np.hypot(plane.x_rad, plane.y_rad).max()), "rad"),
        "data_rate": u.Quantity(setup.camera.n_det * scans.sample_rate_hz, "Hz"),
        "observing_time": u.Quantity(each * setup.scene.observations, "s"),
    }


def _margins(problem: Problem, settings: Mapping[str, Any], computed: Mapping[str, Any]) -> tuple[float, ...]:
    """Margins of all limits whose quantity is known; those of metrics are only after the forecast."""
    keys, keys_of_metrics = problem.values(settings), metric_keys(problem.scene.score.metrics)

    def given(name: str) -> Any:
        return computed[name] if name in computed else keys(name)

    found: list[float] = []
    for limit in problem.limits:
        if any(name in keys_of_metrics and name not in computed for name in names(limit.tree)):
            continue
        found += _margins_of(limit, given)
    return tuple(found)


def _margins_of(limit: Limit, given: Callable[[str], Any]) -> list[float]:
    bounds = {"at_least": limit.at_least, "at_most": limit.at_most}
    try:
        value = value_of(limit.tree, given)
        for name, bound in bounds.items():
            if bound is not None:
                _check_unit(name, bound, value)
        ratios = [] if limit.at_least is None else [_ratio(value, limit.at_least)]
        ratios += [] if limit.at_most is None else [_ratio(limit.at_most, value)]
    except (ArithmeticError, TypeError, ValueError, InputError) as error:
        raise InputError(f"limit of {limit.text!r}: {' '.join(str(error).split())}") from None
    return [math.log(max(ratio, 1e-300)) for ratio in ratios]


def _check_unit(name: str, bound: Any, value: Any) -> None:
    import astropy.units as u

    found, expected = u.Quantity(bound), u.Quantity(value).unit
    if found.value != 0 and not found.unit.is_equivalent(expected):
        allowed = f"a value in {expected}" if str(expected) else "a number without unit"
        raise InputError(f"{name}: found {str(found).strip()}; {allowed} is expected")


def _ratio(above: Any, below: Any) -> float:
    """Return the ratio of two numbers or quantities; infinite over 0."""
    import astropy.units as u

    if u.Quantity(below).value == 0:
        return math.inf
    return float((u.Quantity(above) / u.Quantity(below)).to_value(""))
