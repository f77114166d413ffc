"""Monte Carlo errors of any metric, from its responses to noise and transfer function.

To first order a quantity q changes by ``d ln q = sum_b h_b d ln N_b + t_b d ln T_b`` with the noise PSD N_b and the
transfer function T_b of each bin. The errors of these, which the error of sigma(A) is made of
(`mapmaker.uncertainty`), are then those of q: sign flips, noise common to all of them, weather about the control
variate, simulated skies, and the expectation over weather.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mapmaker.uncertainty import (
    FEWEST,
    ErrorBudget,
    block_sums,
    noise_error_parts,
    student_factor,
    subtract_in_quadrature,
    transfer_function_error,
)
from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.survey.error_modes import Response
from surveysim.survey.scores import DataSetScore, transfer_function_errors

_STEP = 1e-4  # of finite differences in ln N and ln T


@dataclass(frozen=True)
class Estimate:
    """Value of a quantity from the maps of a data set, with its dependence on them and its errors."""

    value: float
    response: Response

    @property
    def error(self) -> float:
        """Standard error; NaN if unknown."""
        return abs(self.value) * self.response.budget.total


def estimates(
    function: Callable[[MapNoise], tuple[Quantity, ...]], item: DataSetScore, quoted: MapNoise, plain: MapNoise
) -> dict[str, tuple[Quantity, Estimate, Estimate]]:
    """Evaluate a metric for one data set.

    Parameters
    ----------
    function
        Function of the metric.
    item
        Score of the data set, with the noise realizations.
    quoted, plain
        Its noise with and without control variate.

    Returns
    -------
    dict
        By name each quantity, its quoted and its plain estimate. As for sigma(A), the errors of both follow from the
        responses of the plain value.
    """
    found = {}
    of_quoted = quantity_responses(function, quoted)
    of_plain = of_quoted if item.control is None else quantity_responses(function, plain)
    for name, (quantity, noise, transmission) in of_quoted.items():
        simulated, *rows = of_plain[name]
        own, drawn = _budgets(item, plain, *rows)
        found[name] = (
            quantity,
            Estimate(quantity.value, Response(noise, transmission, float(noise.sum()), own)),
            Estimate(simulated.value, Response(rows[0], rows[1], float(rows[0].sum()), drawn)),
        )
    return found


def quantity_responses(
    function: Callable[[MapNoise], tuple[Quantity, ...]], noise: MapNoise
) -> dict[str, tuple[Quantity, np.ndarray, np.ndarray]]:
    """Return by name the quantities of a metric with their responses (n_bin,) to ln N and ln T.

    Responses are central differences in each bin, unless the quantity has its own; NaN where the value is not finite.
    """
    found = function(noise)
    n_bin = len(noise.noise_psd)
    rows = np.zeros((2, len(found), n_bin))
    if any(item.response is None for item in found):
        for place in range(n_bin):
            factor = np.ones(n_bin)
            factor[place] = np.exp(_STEP)
            for kind, key in enumerate(("noise", "transmission")):
                sides = [_logarithms(function(noise.scaled(**{key: side}))) for side in (factor, 1 / factor)]
                rows[kind, :, place] = (sides[0] - sides[1]) / (2 * _STEP)
    for place, item in enumerate(found):
        if item.response is not None:
            rows[:, place] = item.response, -item.response
    return {item.name: (item, *rows[:, place]) for place, item in enumerate(found)}


def _logarithms(found: tuple[Quantity, ...]) -> np.ndarray:
    values = np.array([item.value for item in found])
    return np.log(np.where((values > 0) & np.isfinite(values), values, np.nan))


def _budgets(
    item: DataSetScore, plain: MapNoise, noise: np.ndarray, transmission: np.ndarray
) -> tuple[ErrorBudget, ErrorBudget]:
    """Relative errors with and without the control variate, from the responses (n_bin,) of the plain value."""
    if not (np.isfinite(noise).all() and np.isfinite(transmission).all()):
        return (ErrorBudget(np.nan, np.nan, np.nan),) * 2
    skies = transfer_function_error(
        transfer_function_errors(item.transfer_function), transmission, plain.map.correlation
    )
    if not noise.any():
        return (ErrorBudget(0.0, 0.0, skies),) * 2
    of_bins = {"n_modes": plain.map.n_modes, "correlation": plain.map.correlation}
    signs, common = noise_error_parts(item.noise_psds, noise, item.weights[item.weights > 0], **of_bins)
    realizations, exponent = float(np.hypot(signs, common)), float(noise.sum())
    off = block_sums(item.shares(noise, exponent) - item.expected_shares(noise, exponent), item.block)
    n_draw = len(off)
    scatter = float(np.std(off, ddof=1) * n_draw**0.5) if n_draw > 1 else np.nan
    weather = subtract_in_quadrature(scatter, common) * student_factor(n_draw)
    if item.control is None:
        if n_draw < FEWEST:  # the error that a forecast expects of sigma(A), if there is one
            weather = item.budget.weather * abs(exponent)
        return (ErrorBudget(realizations, weather, skies),) * 2
    drawn = float(np.hypot(weather, item.control.sampling * abs(exponent)))
    quoted = ErrorBudget(realizations, weather, skies, item.control.population * abs(exponent))
    return quoted, ErrorBudget(realizations, drawn, skies)
