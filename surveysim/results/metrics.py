"""Metrics of a run: values, Monte Carlo errors and forecasts of every quantity, by data set and key."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from surveysim.forecasting.forecast import DataSetForecast, Forecast
from surveysim.metrics.errors import Estimate, estimates
from surveysim.metrics.map_noise import MapNoise, Quantity, noise_of_forecast, noise_of_score
from surveysim.metrics.registry import METRICS, MetricFunction, metric_functions, metric_table_names
from surveysim.reduction.setup import Setup
from surveysim.results.control_variate import weather_factors
from surveysim.runtime.table import Table
from surveysim.survey.scores import DataSetScore


@dataclass(frozen=True)
class MetricResult:
    """A quantity of a metric for one data set.

    Parameters
    ----------
    quoted, plain : Estimate
        With the forecast as control variate, where there is one, and without.
    unit : str
        Unit as astropy writes it.
    lower_is_better : bool
    forecast : float, optional
        Forecast for the weather of the quoted value.
    note : str
        Remark for readers; empty without one.
    """

    quoted: Estimate
    plain: Estimate
    unit: str
    lower_is_better: bool
    forecast: float | None
    note: str

    @property
    def value(self) -> float:
        """The quoted value."""
        return self.quoted.value

    @property
    def error(self) -> float:
        """Its standard error; NaN if unknown."""
        return self.quoted.error


MetricResults = dict[str, dict[str, MetricResult]]  # by data set and key


@dataclass(frozen=True)
class MetricForecast:
    """A forecast quantity of one data set: over all weather, if that is known, and in the weather drawn."""

    value: float
    drawn: float
    unit: str
    lower_is_better: bool
    note: str


def survey_metrics(setup: Setup, scores: Mapping[str, DataSetScore], expected: Forecast | None) -> MetricResults:
    """Evaluate all metrics of the scene for scored data sets, with the forecast of the same observations."""
    if not scores:
        return {}
    functions, forecasts = metric_functions(setup.scene.score), expected.scores if expected else {}
    return {name: _of_data_set(setup, functions, item, forecasts.get(name)) for name, item in scores.items()}


def _of_data_set(
    setup: Setup, functions: dict[str, MetricFunction], item: DataSetScore, expected: DataSetForecast | None
) -> dict[str, MetricResult]:
    quoted, plain = noise_of_score(setup, item)
    forecast = values(functions, noise_of_forecast(setup, expected)) if expected else {}
    found = {}
    for metric, function in functions.items():
        for name, (quantity, own, drawn) in estimates(function, item, quoted, plain).items():
            key = f"{metric}.{name}"
            seen = forecast[key].value * _ratio(own, drawn) if key in forecast else None
            found[key] = MetricResult(own, drawn, quantity.unit, quantity.lower_is_better, seen, quantity.note)
    return found


def _ratio(quoted: Estimate, plain: Estimate) -> float:
    """Effect of the control variate on a value; 1 without a value."""
    known = all(0 < item.value < math.inf for item in (quoted, plain))
    return quoted.value / plain.value if known else 1.0


def relative_error(setup: Setup, item: DataSetScore, key: str) -> float:
    """Return the relative error of a quantity of one data set as quoted; NaN if unknown."""
    metric, _, name = key.partition(".")
    found = estimates(metric_functions(setup.scene.score)[metric], item, *noise_of_score(setup, item))
    return found[name][1].response.budget.total


def values(functions: Mapping[str, MetricFunction], noise: MapNoise) -> dict[str, Quantity]:
    """Return the quantities of some metrics by key."""
    return {f"{name}.{item.name}": item for name, function in functions.items() for item in function(noise)}


def metric_tables(setup: Setup, scores: Mapping[str, DataSetScore]) -> dict[str, Table]:
    """Return the tables that metrics have of their own, by name of the file; none without scores."""
    if not scores:
        return {}
    items = {name: (noise_of_score(setup, item)[0], item) for name, item in scores.items()}
    found = metric_table_names(setup.scene.score)
    return {name: METRICS[options.kind].table(options, items) for name, options in found.items()}


def drawn_metrics(setup: Setup, found: Forecast) -> dict[str, dict[str, Quantity]]:
    """Evaluate all metrics of the scene for a forecast, in the weather drawn, by data set and key."""
    functions = metric_functions(setup.scene.score)
    return {name: values(functions, noise_of_forecast(setup, item)) for name, item in found.scores.items()}


def forecast_metrics(setup: Setup, found: Forecast) -> dict[str, dict[str, MetricForecast]]:
    """Evaluate all metrics of the scene for a forecast, by data set and key."""
    functions, factors = metric_functions(setup.scene.score), weather_factors(setup)
    metrics = {}
    for name, drawn in drawn_metrics(setup, found).items():
        noise = noise_of_forecast(setup, found.scores[name], factors.get(name, 1.0))
        everywhere = values(functions, noise) if name in factors else drawn
        metrics[name] = {
            key: MetricForecast(item.value, drawn[key].value, item.unit, item.lower_is_better, item.note)
            for key, item in everywhere.items()
        }
    return metrics
