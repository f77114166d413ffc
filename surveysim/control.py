"""The forecast as a control variate: what its weather makes of a sample's score is taken out by closed forms.

A survey whose observations happen to see good weather has less noise, in a forecast as in a simulation. The
simulated sigma(A) times what the forecast expects over all weather, over what it expects of the very observations that
were simulated, is therefore free of the weather that they happened to draw.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mapmaker.bandpower import flat_band_power, ratio_error, sign_error
from surveysim.coadds import CoAdds, row_names
from surveysim.conditions import conditions, population, survey_draws
from surveysim.forecast import NoiseModel, can_forecast, expected_weights, survey_models
from surveysim.scene import Scene, SceneError
from surveysim.scores import DataSetScore
from surveysim.setup import Setup, prepare


@dataclass(frozen=True)
class ControlBudget:
    """Relative standard errors of a controlled sigma.

    `noise` of the realizations, `forecast` of observations that are not to each other as the forecast says (beyond
    their noise), `window` of the signal, and `population` of the sample that the forecast's expectation is taken from.
    """

    noise: float
    forecast: float
    window: float
    population: float

    @property
    def total(self) -> float:
        """The parts, being independent, in quadrature."""
        return float(np.linalg.norm([self.noise, self.forecast, self.window, self.population]))


@dataclass(frozen=True)
class Controlled:
    """sigma(A) [uK_CMB^2] of a data set with the forecast as control variate, `factor` times the plain one."""

    sigma_ukcmb2: float
    error_ukcmb2: float
    factor: float
    budget: ControlBudget


@dataclass(frozen=True)
class Expectation:
    """A data set's noise model, its forecast of a survey in all weather and the relative error of that."""

    model: NoiseModel
    sigma: float
    error: float


def controlled_scores(setup: Setup, coadds: CoAdds, scores: dict[str, DataSetScore]) -> dict[str, Controlled]:
    """Controlled estimates of the scores that can be forecast, from the observations that gave the scores."""
    if not can_forecast(setup):
        return {}
    try:
        expected = expectations(setup.scene)
        levels = conditions(setup, survey_draws(setup, 0, coadds.done))
        return {
            name: _controlled(setup, coadds, item, expected[name], expected[name].model.noise(levels))
            for name, item in scores.items()
            if name in expected
        }
    except ValueError:  # extremes that can't be forecast: a run never fails for want of one
        return {}


@lru_cache(maxsize=1)
def expectations(scene: Scene) -> dict[str, Expectation]:
    """Forecasts of a scene's data sets in expectation over weather; raises SceneError where there are none."""
    setup = prepare(scene)
    levels, n_lists = population(scene)
    found = {}
    for model in survey_models(scene):
        noise = model.noise(levels)
        if not noise[:, setup.band.selected].all():
            raise SceneError("score: found no noise in its multipoles; some is expected")
        parts = [_sigma(setup, model, part) for part in np.split(noise, n_lists)]
        error = np.std(parts, ddof=1) / np.sqrt(len(parts)) / np.mean(parts)
        found[model.name] = Expectation(model, _sigma(setup, model, noise), float(error))
    return found


def _sigma(setup: Setup, model: NoiseModel, noise: np.ndarray) -> float:
    """sigma(A), up to a factor, of a survey of one length that consists of these (n_draw, n_bin) observations."""
    weight = expected_weights(setup, noise)
    psd = weight**2 @ noise * len(noise) / weight.sum() ** 2
    return flat_band_power(psd, model.signal_psd, setup.band.rings.n_modes, setup.band.selected)


def _controlled(
    setup: Setup, coadds: CoAdds, item: DataSetScore, expected: Expectation, noise: np.ndarray
) -> Controlled:
    factor = expected.sigma / _sigma(setup, expected.model, noise)
    place = row_names(setup).index(f"discarded_{expected.model.recipe.data_set}")
    kept = 1 - np.array([row[place] for row in coadds.rows]) / setup.raster.n_scans
    # An observation's information is known as well as its noise; that part of its scatter is in the noise's error.
    scatter = ratio_error(item.weights * kept, expected_weights(setup, noise))
    used = item.weights[item.weights > 0]
    common = item.budget.noise**2 - sign_error(item.noise_psds, item.band.weight, used) ** 2
    off = float(np.sqrt(max(scatter**2 - common, 0.0)))
    budget = ControlBudget(item.budget.noise, off, item.budget.window, expected.error)
    sigma = item.band.sigma_ukcmb2 * factor
    return Controlled(sigma, sigma * budget.total, factor, budget)
