"""The forecast as a control variate: what its weather makes of a sample's score is taken out by closed forms.

A survey whose observations happen to see good weather has less noise, in a forecast as in a simulation. The
simulated sigma(A) times what the forecast expects over all weather, over what it expects of the very observations that
were simulated, is therefore free of the weather that they happened to draw.
"""

from dataclasses import dataclass

import numpy as np

from mapmaker.bandpower import bin_weights, flat_band_power
from mapmaker.uncertainty import information_shares
from surveysim.forecasting.forecast import Forecast, can_forecast, expected_weights
from surveysim.forecasting.noise_model import NoiseModel, survey_models
from surveysim.forecasting.observing_conditions import observing_conditions, population_conditions, survey_draws
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup
from surveysim.runtime.errors import InputError, NotForecastableError
from surveysim.runtime.once import keep_last
from surveysim.survey.coadds import CoAdds
from surveysim.survey.scores import Control, DataSetScore, controlled_score, score_survey


@dataclass(frozen=True)
class Expectation:
    """A data set's noise model, and its forecast over all weather.

    `psd` (n_bin,) of a survey, up to a factor, `error` the relative one of its sigma(A); `variation` the standard
    deviation of the observations' information over its mean.
    """

    model: NoiseModel
    psd: np.ndarray
    error: float
    variation: float


def quoted_scores(setup: Setup, coadds: CoAdds, names: tuple[str, ...] | None = None) -> dict[str, DataSetScore]:
    """Scores as they are quoted everywhere, of the named data sets (all by default): controlled where it can be.

    Sets that have no forecast of their own are controlled by that of the actual data: any expectation of an
    observation's information will do, and what it does not explain is in the error. Raises ValueError as
    `surveysim.survey.scores.score_survey`.
    """
    scores = score_survey(setup, coadds, names)
    found = controls(setup, coadds)
    if not found:
        return scores
    return {name: controlled_score(setup, item, found.get(name, found[ACTUAL])) for name, item in scores.items()}


def controls(setup: Setup, coadds: CoAdds) -> dict[str, Control]:
    """Control variates by data set, those of the observations in `coadds`; empty where there is no forecast."""
    expected = known_expectations(setup)
    try:
        levels = observing_conditions(setup, survey_draws(setup, 0, coadds.done)) if expected else None
        return {name: _control(setup, item, item.model.noise(levels)) for name, item in expected.items()}
    except InputError:  # extremes that can't be forecast: a run never fails for want of one
        return {}


def known_expectations(setup: Setup) -> dict[str, Expectation]:
    """The `expectations` of a scene, empty where it has none."""
    try:
        return expectations(setup) if can_forecast(setup) else {}
    except InputError:
        return {}


@keep_last(1)
def expectations(setup: Setup) -> dict[str, Expectation]:
    """Forecasts of the data sets in expectation over weather; raises NotForecastableError without."""
    levels, n_lists = population_conditions(setup)
    found = {}
    for model in survey_models(setup):
        noise = model.noise(levels)
        if not noise[:, setup.analysis.region.selected].all():
            raise NotForecastableError("score: found no noise in its multipoles; some is expected")
        parts = [_sigma(setup, model, _psd(setup, part)) for part in np.split(noise, n_lists)]
        error = np.std(parts, ddof=1) / np.sqrt(len(parts)) / np.mean(parts)
        psd = _psd(setup, noise)
        of_bins = bin_weights(
            psd, model.signal_psd, setup.analysis.region.rings.n_modes, setup.analysis.region.selected
        )
        shares = information_shares(expected_weights(setup, noise), 1.0, noise, of_bins)
        found[model.name] = Expectation(model, psd, float(error), float(shares.std() / shares.mean()))
    return found


def in_all_weather(setup: Setup, found: Forecast) -> dict[str, float]:
    """sigma(A) [uK_CMB^2] of a forecast's data sets over all weather, as runs quote it; of those that have it.

    A forecast itself is of the weather that the scene's seed draws for its observations.
    """
    levels, band = observing_conditions(setup, survey_draws(setup, 0, setup.scene.observations)), setup.analysis.region
    controlled = {}
    for name, item in known_expectations(setup).items():
        psd = found.scores[name].noise_psd * _control(setup, item, item.model.noise(levels)).factor
        controlled[name] = flat_band_power(psd, item.model.signal_psd, band.rings.n_modes, band.selected)
    return controlled


def _psd(setup: Setup, noise: np.ndarray) -> np.ndarray:
    """Noise PSD (n_bin,), up to a factor, of a survey of one length of these (n_draw, n_bin) observations."""
    weight = expected_weights(setup, noise)
    return weight**2 @ noise * len(noise) / weight.sum() ** 2


def _sigma(setup: Setup, model: NoiseModel, psd: np.ndarray) -> float:
    return flat_band_power(psd, model.signal_psd, setup.analysis.region.rings.n_modes, setup.analysis.region.selected)


def _control(setup: Setup, expected: Expectation, noise: np.ndarray) -> Control:
    of_sample = _psd(setup, noise)
    factor = np.divide(expected.psd, of_sample, out=np.ones_like(of_sample), where=of_sample > 0)
    sampling = expected.variation / np.sqrt(len(noise))
    return Control(factor, expected_weights(setup, noise), noise, float(sampling), expected.error)
