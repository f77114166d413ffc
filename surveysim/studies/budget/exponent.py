"""Power of the noise power that a metric goes with."""

import numpy as np

from surveysim.forecasting.forecast import forecast
from surveysim.metrics.map_noise import noise_of_forecast
from surveysim.metrics.registry import metric_functions
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import prepare
from surveysim.results.metrics import values
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.studies.budget.points import WHOLE
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.point_store import PointResult

_STEP = 1e-3  # of the noise power, in its logarithm


def noise_exponent(sweep: Sweep, whole: PointResult) -> float:
    """Return the exponent of a sweep's metric in the noise power of the map of the whole scene; NaN without a score.

    It is 1 for sigma(A). Of a forecast it is a finite difference.
    """
    if sweep.metric == SIGMA_KEY:
        return 1.0
    if whole.metrics:
        return whole.metrics[ACTUAL][sweep.metric].quoted.response.exponent
    if not whole.metric_forecasts:
        return np.nan
    setup = prepare(sweep.points[WHOLE].scene)
    noise, functions = noise_of_forecast(setup, forecast(setup).scores[ACTUAL]), metric_functions(setup.scene.score)
    up, down = (values(functions, noise.scaled(np.exp(side * _STEP)))[sweep.metric].value for side in (1, -1))
    return float((np.log(up) - np.log(down)) / (2 * _STEP))
