"""Agreement of the forecast with a run: ratios with their errors."""

from dataclasses import dataclass

import numpy as np

from mapmaker.uncertainty import draws, ratio_error, student_factor, subtract_in_quadrature
from surveysim.forecasting.forecast import DataSetForecast
from surveysim.forecasting.validity import compared_ell
from surveysim.reduction.setup import Setup
from surveysim.results.results import GOOD_PSD, KNOWN, SurveyResult
from surveysim.survey.scores import DataSetScore, bin_errors, noise_parts


@dataclass(frozen=True)
class Agreement:
    """Forecast over simulation of one data set, less 1, for the same observations, weather and kept scans.

    Parameters
    ----------
    sigma, sigma_error : float
        Of sigma(A), with the standard error; NaN with fewer than 4 observations.
    psd, psd_error, worst_ell : float, optional
        Of the noise PSD in the bin with the largest deviation beyond two standard errors, and its multipole; None
        without bins.
    low_ell, high_ell : float, optional
        Range of multipoles of the compared bins.
    bins, within, unknown : int
        Number of compared bins; of bins within `GOOD_PSD` and with an error below `KNOWN`; of bins with a larger error.
    """

    sigma: float
    sigma_error: float
    psd: float | None = None
    psd_error: float | None = None
    worst_ell: float | None = None
    low_ell: float | None = None
    high_ell: float | None = None
    bins: int = 0
    within: int = 0
    unknown: int = 0


def forecast_agreement(result: SurveyResult) -> dict[str, Agreement]:
    """Return the agreement of the forecast of each data set with the run; empty without a forecast."""
    expected = result.expected.scores if result.expected else {}
    return {name: agreement(result.setup, result.scores[name], item) for name, item in expected.items()}


def agreement(setup: Setup, simulated: DataSetScore, expected: DataSetForecast) -> Agreement:
    """Compare the forecast of one data set with its simulation.

    The weather is common to both and cancels in their ratio. The error has three parts: noise realizations, scatter of
    the observations' noise about its forecast, and for sigma(A) the error of the transfer function.

    Parameters
    ----------
    setup : Setup
        Setup of the run.
    simulated : DataSetScore
        Score of the data set.
    expected : DataSetForecast
        Forecast of the same observations.
    """
    scatter = _scatter(setup, simulated, expected)
    ratio = expected.band.sigma_ukcmb2 / simulated.plain_band.sigma_ukcmb2
    error = ratio * float(np.linalg.norm([simulated.budget.noise, simulated.budget.transfer_function, scatter]))
    low, high = compared_ell(setup.scene)
    edges = setup.analysis.region.rings.edges_ell
    bins = np.flatnonzero((edges[:-1] >= low) & (edges[1:] <= high))
    if not len(bins):
        return Agreement(sigma=ratio - 1, sigma_error=error)
    off, errors = _bin_ratios(setup, simulated, expected, bins, scatter)
    worst = int(np.argmax(np.abs(off) - 2 * np.nan_to_num(errors)))
    known = errors <= KNOWN
    return Agreement(
        sigma=ratio - 1,
        sigma_error=error,
        psd=float(off[worst]),
        psd_error=float(errors[worst]),
        worst_ell=float(simulated.band.ell[bins[worst]]),
        low_ell=float(edges[bins[0]]),
        high_ell=float(edges[bins[-1] + 1]),
        bins=len(bins),
        within=int(np.sum(known & (np.abs(off) <= GOOD_PSD))),
        unknown=int(np.sum(~known)),
    )


def _scatter(setup: Setup, simulated: DataSetScore, expected: DataSetForecast) -> float:
    """Relative error of the co-added noise from the scatter of observations about their forecasts, beyond their own
    noise.

    That noise is the part of the error of the noise realizations that all have in common. As for the control variate,
    this is the error of a mean of few draws, estimated from them (`student_factor`); NaN for fewer than 4.
    """
    kept = expected.kept.share
    some = kept > 0
    block = None if simulated.block is None else np.unique(simulated.block[some], return_inverse=True)[1]
    total = ratio_error((simulated.weights * kept)[some], (expected.weights * kept)[some], block)
    _, common = noise_parts(setup.analysis, simulated)
    return subtract_in_quadrature(total, common) * student_factor(draws(int(np.count_nonzero(some)), block))


def _bin_ratios(
    setup: Setup, simulated: DataSetScore, expected: DataSetForecast, bins: np.ndarray, scatter: float
) -> tuple[np.ndarray, np.ndarray]:
    """Forecast over simulated noise PSD, minus 1, in some bins, and its errors, (n,) each."""
    ratio = expected.noise_psd[bins] / simulated.noise_psd[bins]
    return ratio - 1, ratio * np.hypot(bin_errors(setup.analysis, simulated)[bins], scatter)
