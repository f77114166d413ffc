"""Forecast as control variate: it removes the effect of the drawn weather on a score.

A survey that happens to have good weather has less noise, in a forecast as in a simulation. Multiply the simulated
sigma(A) by the forecast for all weather, divided by the forecast for the simulated observations: the result does not
depend on the weather that they happened to draw.
"""

from dataclasses import dataclass, replace

import numpy as np

from mapmaker.bandpower import bin_weights, flat_band_power
from mapmaker.uncertainty import information_shares
from surveysim.forecasting.forecast import Forecast, can_forecast
from surveysim.forecasting.map_makers import single_observations
from surveysim.forecasting.noise_model import NoiseModel, noise_models, survey_models
from surveysim.forecasting.observation_weights import expected_weights
from surveysim.forecasting.observing_conditions import observing_conditions, population_conditions, survey_draws
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup
from surveysim.runtime.errors import InputError, NotForecastableError
from surveysim.runtime.once import keep_last
from surveysim.survey.coadds import CoAdds
from surveysim.survey.scores import Control, DataSetScore, controlled_score, score_survey


@dataclass(frozen=True)
class Expectation:
    """Noise model of a data set, and its forecast over all weather.

    Attributes
    ----------
    psd : (n_bin,)
        Noise PSD of a survey, up to a factor.
    error
        Relative error of its sigma(A).
    variation
        Standard deviation of the observations' information over its mean.
    """

    model: NoiseModel
    psd: np.ndarray
    error: float
    variation: float


def quoted_scores(setup: Setup, coadds: CoAdds, names: tuple[str, ...] | None = None) -> dict[str, DataSetScore]:
    """Score data sets by name (all by default), with the control variate where there is a forecast.

    Sets without a forecast use the control variate of the actual data: any expectation of an observation's information
    is allowed, as the error includes the remaining scatter. Maps that are solved for have none: where too few
    observations tell the error of the drawn weather, it is the one that a forecast expects. Raises as
    `surveysim.survey.scores.score_survey`.
    """
    scores = score_survey(setup, coadds, names)
    found = controls(setup, coadds)
    if not found:
        return {name: _in_drawn_weather(setup, item) for name, item in scores.items()}
    return {
        name: controlled_score(setup.analysis, item, found.get(name, found[ACTUAL])) for name, item in scores.items()
    }


def controls(setup: Setup, coadds: CoAdds) -> dict[str, Control]:
    """Compute control variates by data set for the observations in `coadds`; empty without a forecast."""
    expected = known_expectations(setup)
    try:
        conditions = observing_conditions(setup, survey_draws(setup, 0, coadds.done)) if expected else None
        return {name: _control(setup, item, item.model.noise(conditions)) for name, item in expected.items()}
    except InputError:  # extreme scenes without a forecast; the run goes on without it
        return {}


def known_expectations(setup: Setup) -> dict[str, Expectation]:
    """Return the `expectations` of a scene; empty without any, and for maps that are solved for.

    The noise of these is no sum over observations.
    """
    try:
        return expectations(setup) if can_forecast(setup) and not setup.scene.map.solved else {}
    except InputError:
        return {}


def _in_drawn_weather(setup: Setup, item: DataSetScore) -> DataSetScore:
    """Give the score of a map that is solved for the expected error of the drawn weather, where it has none."""
    if not setup.scene.map.solved or np.isfinite(item.budget.weather):
        return item
    try:
        variation = expected_variation(setup) if can_forecast(setup) else np.nan
    except InputError:  # extreme scenes without a forecast
        return item
    budget = replace(item.budget, weather=_sampling_error(setup, variation, len(item.weights)))
    return replace(item, budget=budget, band=replace(item.band, error_ukcmb2=item.band.sigma_ukcmb2 * budget.total))


@keep_last(1)
def expected_variation(setup: Setup) -> float:
    """Forecast the standard deviation over weather of the observations' information in a map that is solved for, over
    its mean.

    Raises
    ------
    NotForecastableError
        As `noise_models`.
    """
    conditions, n_lists = population_conditions(setup)
    some = conditions.some(slice(0, len(conditions.sine) // n_lists))
    model = next(noise_models(setup, some))
    return _variation(setup, model, single_observations(setup, model.pipeline, some))


def _variation(setup: Setup, model: NoiseModel, noise: np.ndarray) -> float:
    """Standard deviation of the information of draws of noise (n_draw, n_bin), over its mean."""
    modes, selected = setup.analysis.region.rings.n_modes, setup.analysis.region.selected
    of_bins = bin_weights(_psd(setup, noise), model.signal_psd, modes, selected)
    shares = information_shares(expected_weights(setup.analysis, noise), 1.0, noise, of_bins)
    return float(shares.std() / shares.mean())


def _sampling_error(setup: Setup, variation: float, n_obs: int) -> float:
    """Relative error of sigma from as many observations in random weather."""
    dated, with_water = setup.air.dated, setup.air.water is not None
    factor_of_mean = 1.0 if dated is None else dated.sampling_factor(with_water=with_water)
    return float(variation * np.sqrt(factor_of_mean / n_obs))


@keep_last(1)
def expectations(setup: Setup) -> dict[str, Expectation]:
    """Forecast each data set in expectation over weather.

    Raises
    ------
    NotForecastableError
        Without noise in the scored multipoles.
    """
    conditions, n_lists = population_conditions(setup)
    found = {}
    for model in survey_models(setup):
        noise = model.noise(conditions)
        if not noise[:, setup.analysis.region.selected].all():
            raise NotForecastableError("score: found no noise in its multipoles; some is expected")
        parts = [_sigma(setup, model, _psd(setup, part)) for part in np.split(noise, n_lists)]
        error = np.std(parts, ddof=1) / np.sqrt(len(parts)) / np.mean(parts)
        found[model.name] = Expectation(model, _psd(setup, noise), float(error), _variation(setup, model, noise))
    return found


def weather_factors(setup: Setup) -> dict[str, np.ndarray]:
    """Return by data set the noise PSD (n_bin,) over all weather, over that in the weather that the scene's seed draws.

    Data sets without a forecast over all weather have none.
    """
    conditions = observing_conditions(setup, survey_draws(setup, 0, setup.scene.observations))
    expected = known_expectations(setup)
    return {name: _control(setup, item, item.model.noise(conditions)).factor for name, item in expected.items()}


def in_all_weather(setup: Setup, found: Forecast) -> dict[str, float]:
    """Return sigma(A) [uK_CMB^2] of a forecast over all weather, as runs quote it, for data sets that have it.

    The forecast itself is for the weather that the scene's seed draws.
    """
    region, factors, expected = setup.analysis.region, weather_factors(setup), known_expectations(setup)
    controlled = {}
    for name, factor in factors.items():
        psd, signal = found.scores[name].noise_psd * factor, expected[name].model.signal_psd
        controlled[name] = flat_band_power(psd, signal, region.rings.n_modes, region.selected)
    return controlled


def _psd(setup: Setup, noise: np.ndarray) -> np.ndarray:
    """Noise PSD (n_bin,), up to a factor, of a survey of these (n_draw, n_bin) observations."""
    weight = expected_weights(setup.analysis, noise)
    return weight**2 @ noise * len(noise) / weight.sum() ** 2


def _sigma(setup: Setup, model: NoiseModel, psd: np.ndarray) -> float:
    return flat_band_power(psd, model.signal_psd, setup.analysis.region.rings.n_modes, setup.analysis.region.selected)


def _control(setup: Setup, expected: Expectation, noise: np.ndarray) -> Control:
    of_sample = _psd(setup, noise)
    factor = np.divide(expected.psd, of_sample, out=np.ones_like(of_sample), where=of_sample > 0)
    sampling = _sampling_error(setup, expected.variation, len(noise))
    return Control(factor, expected_weights(setup.analysis, noise), noise, sampling, expected.error)
