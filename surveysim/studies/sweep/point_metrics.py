"""Metrics of a finished point in its file: numbers as JSON, responses as arrays."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from mapmaker.uncertainty import ErrorBudget
from surveysim.metrics.errors import Estimate
from surveysim.results.metrics import MetricResult, MetricResults
from surveysim.scene.metrics import metric_keys
from surveysim.scene.scene import Scene
from surveysim.survey.error_modes import Response

_PARTS = ("quoted", "plain")
_ARRAYS = ("noise", "transmission")
Identifier = tuple[str, str]  # data set and key of a quantity


class Numbers(BaseModel):
    """Fields with fixed types and no others; NaN stands for an unknown value."""

    model_config = ConfigDict(strict=True, extra="forbid")


class Budget(Numbers):
    """Relative errors by origin."""

    noise: float
    weather: float
    transfer_function: float
    population: float


class _Estimate(Numbers):
    value: float
    exponent: float
    budget: Budget


class Metric(Numbers):
    """Numbers of a quantity."""

    quoted: _Estimate
    plain: _Estimate
    unit: str
    lower_is_better: bool
    forecast: float | None
    note: str


def metric_numbers(metrics: MetricResults) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the numbers of metrics by data set and key, as `Metric` reads them."""
    return {name: {key: _numbers(item) for key, item in found.items()} for name, found in metrics.items()}


def _numbers(item: MetricResult) -> dict[str, Any]:
    found = {key: getattr(item, key) for key in ("unit", "lower_is_better", "forecast", "note")}
    for part in _PARTS:
        estimate: Estimate = getattr(item, part)
        response = estimate.response
        found[part] = {
            "value": estimate.value,
            "exponent": response.exponent,
            "budget": vars(response.budget),
        }
    return found


def metric_arrays(metrics: MetricResults) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the names and arrays (n_bin,) of the responses of metrics."""
    for name, found in metrics.items():
        for key, item in found.items():
            for part in _PARTS:
                for array in _ARRAYS:
                    yield _array_name(name, key, part, array), getattr(getattr(item, part).response, array)


def read_metrics(file: Mapping[str, np.ndarray], numbers: Mapping[str, Mapping[str, Metric]]) -> MetricResults:
    """Read metrics from the arrays of a file and their numbers; raises KeyError without an array."""
    return {
        name: {key: _metric(file, (name, key), item) for key, item in found.items()} for name, found in numbers.items()
    }


def _metric(file: Mapping[str, np.ndarray], where: Identifier, numbers: Metric) -> MetricResult:
    estimates: dict[str, Any] = {}
    for part in _PARTS:
        found: _Estimate = getattr(numbers, part)
        noise, transmission = (file[_array_name(*where, part, array)] for array in _ARRAYS)
        budget = ErrorBudget(**found.budget.model_dump())
        estimates[part] = Estimate(found.value, Response(noise, transmission, found.exponent, budget))
    rest = numbers.model_dump(exclude=set(_PARTS))
    return MetricResult(**estimates, **rest)


def _array_name(name: str, key: str, part: str, array: str) -> str:
    return f"{name}/metrics/{key}/{part}.{array}"


def check_metrics(metrics: MetricResults, scene: Scene, data_sets: set[str], n_bin: int) -> None:
    """Raise ValueError for metrics that do not fit the scene, its scored data sets and its bins."""
    keys = list(metric_keys(scene.score.metrics))
    if set(metrics) != data_sets or any(list(found) != keys for found in metrics.values()):
        raise ValueError("other metrics than the scene's")
    check_responses(metrics, n_bin)


def check_responses(metrics: MetricResults, n_bin: int) -> None:
    """Raise ValueError for responses of other shapes than the bins, and for errors without a response."""
    for name, array in metric_arrays(metrics):
        if array.shape != (n_bin,) or array.dtype != float:
            raise ValueError(f"{name} has the shape {array.shape} of {array.dtype}")
    for item in (item for found in metrics.values() for item in found.values()):
        for response in (item.quoted.response, item.plain.response):
            known = np.isfinite([response.noise, response.transmission]).all()
            if np.isfinite(response.budget.total) and not known:
                raise ValueError("a metric with an error has a response that is no number")
