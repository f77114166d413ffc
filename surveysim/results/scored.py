"""Scores of a finished run, and what follows from them."""

from surveysim.forecasting.forecast import Forecast, can_forecast, forecast
from surveysim.reduction.setup import Setup
from surveysim.results.alternatives import alternatives
from surveysim.results.control_variate import quoted_scores
from surveysim.results.gains import data_set_gains
from surveysim.results.metrics import MetricResults, survey_metrics
from surveysim.runtime.errors import NotForecastableError
from surveysim.survey.coadds import CoAdds, kept_shares
from surveysim.survey.error_modes import Gain
from surveysim.survey.scores import DataSetScore, flux_removed

Scored = tuple[
    dict[str, DataSetScore],
    dict[str, Gain],
    list[dict[str, float | str]],
    dict[str, float],
    Forecast | None,
    MetricResults,
]


def scored_parts(setup: Setup, coadds: CoAdds) -> Scored:
    """Return scores, gains, alternatives, removed flux, forecast and metrics, as `SurveyResult` has them.

    Raises
    ------
    InsufficientDataError
        With too few observations, or too few scans kept in them.
    """
    scores = quoted_scores(setup, coadds)
    ratios, others = data_set_gains(setup, scores), alternatives(setup, coadds, scores)
    removed, expected = flux_removed(setup.analysis, coadds), run_forecast(setup, coadds)
    return scores, ratios, others, removed, expected, survey_metrics(setup, scores, expected)


def run_forecast(setup: Setup, coadds: CoAdds) -> Forecast | None:
    """Return the forecast of a run's own observations and kept scans; None for a scene without one."""
    try:
        return forecast(setup, kept_shares(setup, coadds)) if can_forecast(setup) else None
    except NotForecastableError:  # the run goes on without a forecast
        return None
