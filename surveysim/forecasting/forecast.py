"""The noise of a survey's map without a Monte Carlo: closed forms for every part of the streams.

Each observation's noise in a map mode is that of `surveysim.forecasting.noise_model`; observations are weighted and
co-added as in a run, with the weather that the scene's seed draws for them.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.bandpower import BandPower, band_power, flat_spectrum_psd
from mapmaker.transfer_function import beam_window
from surveysim.forecasting.noise_model import NoiseModel, is_projection, survey_models
from surveysim.forecasting.observing_conditions import Conditions, conditions, mean_hits, survey_draws
from surveysim.forecasting.pilot import Kept, predicted_kept
from surveysim.forecasting.validity import Effect, Grounds, effects
from surveysim.reduction.mode_response import PROJECTIONS
from surveysim.reduction.setup import Setup, prepare
from surveysim.scene.scene import Scene, SceneError
from surveysim.survey.discarded_scans import REMEDY

if TYPE_CHECKING:
    from astropy.table import QTable

    from surveysim.runtime.table import Table

NOTHING_FOUND = "score: found no noise in its multipoles or no scan across its patch; both are expected"


@dataclass(frozen=True)
class DataSetForecast:
    """One data set's forecast: `noise_psd` [uK_CMB^2 sr], `signal_psd` [sr] and `transmission`, (n_bin,).

    `weights` (n_obs,) [1/mK^2 a sample] of its observations and the scans that are `kept` of them; `effects` are those
    that it neglects, and where it is out of its range.
    """

    name: str
    n_det: int
    band: BandPower
    noise_psd: np.ndarray
    signal_psd: np.ndarray
    transmission: np.ndarray
    weights: np.ndarray
    kept: Kept
    effects: tuple[Effect, ...]


@dataclass(frozen=True)
class Forecast:
    """Forecasts by data set, in bins around `ell` (n_bin,); without the best of each observation and no projections."""

    ell: np.ndarray
    scores: dict[str, DataSetForecast]

    def table(self) -> "QTable":
        """Return sigma(A) of each data set with units."""
        return self._table().quantities()

    def _table(self) -> "Table":
        from surveysim.forecasting.table import forecast_table

        return forecast_table(self.scores)

    def __repr__(self) -> str:
        """A line above the table of scores."""
        return f"Forecast of {len(self.scores)} data sets\n{self._table().text()}"

    def _repr_html_(self) -> str:
        """The table of scores."""
        return self._table().html()


def forecast(scene: Scene, kept: dict[str, np.ndarray] | None = None) -> Forecast:
    """Forecast the data sets of a scene.

    `kept` holds, by the data set of each pipeline, the share of scans (n_obs,) that a run kept of each of the survey's
    first observations: the forecast is then that of the survey as judged by them. By default it is predicted
    (`surveysim.forecasting.pilot`).

    Raises SceneError for a scene that can't be run, has no [score], or a first cleaning that is none of `PROJECTIONS`.
    """
    setup = prepare(scene)
    if scene.score is None:
        raise SceneError("score: missing; a forecast says what a map is worth")
    if not can_forecast(setup):
        allowed = ", ".join(map(repr, PROJECTIONS))
        raise SceneError(f"cleaning.algorithm: found {setup.pipelines[0].label!r}; one of {allowed} can be forecast")
    models = survey_models(scene)
    if kept is None:
        levels = conditions(setup, survey_draws(setup, 0, scene.observations))
        weight = expected_weights(setup, _some_noise(setup, models[0], levels))
        scans = predicted_kept(setup, tuple(filter(is_projection, setup.pipelines)), levels, weight)
    else:
        levels = conditions(setup, survey_draws(setup, 0, len(next(iter(kept.values())))))
        scans = {name: Kept(share) for name, share in kept.items()}
    found: dict[str, DataSetForecast] = {}
    for model in models:
        if model.name == model.pipeline.data_set:  # the sets that follow share its detectors
            hits = mean_hits(setup, model.pipeline)
        found[model.name] = _scored(setup, model, levels, scans[model.pipeline.data_set], hits)
    return Forecast(setup.band.rings.ell, {name: found[name] for name in setup.data_sets if name in found})


def can_forecast(setup: Setup) -> bool:
    """Whether a prepared scene has a score and its first cleaning can be forecast."""
    return setup.scene.score is not None and is_projection(setup.pipelines[0])


def _scored(setup: Setup, model: NoiseModel, levels: Conditions, kept: Kept, hits: np.ndarray) -> DataSetForecast:
    """Weight and co-add observations in the conditions `levels`; score the map."""
    scene, band, rings = setup.scene, setup.band, setup.band.rings
    noise, taper, covered = _some_noise(setup, model, levels), band.taper**2, hits > 0
    if not taper[covered].any():
        raise SceneError(NOTHING_FOUND)
    if not kept.share.any():
        raise SceneError(
            f"cleaning: found no scan that is kept, {'by a trial of a few' if kept.error else 'in this run'}; some are "
            f"expected. {REMEDY}"
        )
    weight = expected_weights(setup, noise)
    # Hits go as the scans that are kept; the PSD of a survey as one over its observations.
    variance = (weight**2 * kept.share) @ noise / (weight @ kept.share) ** 2 * (len(noise) / scene.observations)
    area = setup.geometry.pixel_rad**2 * np.sum(taper[covered] / hits[covered]) / np.sum(taper)
    psd = variance * area * (1e3 * scene.instrument.cmb_per_rj) ** 2
    signal = model.signal_psd
    score = band_power(psd, signal, rings.n_modes, band.selected, rings.ell, rings.edges_ell, 0.0)
    layer = model.layer_noise(levels)
    grounds = Grounds(model.pipeline, model.n_det, levels, kept, weight, noise, layer, score.weight, hits)
    passed = signal / band.signal_psd
    found = effects(setup, grounds)
    return DataSetForecast(model.name, model.n_det, score, psd, signal, passed, weight, kept, found)


def _some_noise(setup: Setup, model: NoiseModel, levels: Conditions) -> np.ndarray:
    """Noise variance a sample (n_draw, n_bin); raises SceneError where there is none in a scored multipole."""
    noise = model.noise(levels)
    if not noise[:, setup.band.selected].all():
        raise SceneError(NOTHING_FOUND)
    return noise


def expected_weights(setup: Setup, noise: np.ndarray) -> np.ndarray:
    """Weight (n_draw,) [1/mK^2] of observations whose noise a sample is (n_draw, n_bin): as a run measures it."""
    band = setup.band
    sky = _beamed_sky(setup)
    weight = band.rings.n_modes * (sky * band.selected / sky[band.selected].max()) ** 2
    return 1 / (noise @ weight / weight.sum())


def _beamed_sky(setup: Setup) -> np.ndarray:
    ell = setup.band.rings.ell
    # The lowest bin of a small map may hold nothing but ell = 0.
    return flat_spectrum_psd(np.maximum(ell, 1)) * beam_window(ell, setup.scene.instrument.beam_fwhm_rad)
