"""Forecast of the noise of a survey's map without a Monte Carlo.

Each observation's noise in a map mode follows from `surveysim.forecasting.noise_model`. Observations are weighted and
co-added as in a run, in the weather that the scene's seed draws for them: with weights w_i, fractions k_i of kept scans
and the noise N_ib a sample,

    N_b = A (n_obs / n_survey) sum_i w_i^2 k_i N_ib / (sum_i w_i k_i)^2,

where A converts the variance a sample to the PSD of the tapered map: pixel area times the mean of 1 / hits.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.bandpower import BandPower, band_power
from surveysim.forecasting.closed_forms import CLOSED_FORMS
from surveysim.forecasting.coverage import mean_hits
from surveysim.forecasting.map_makers import solved_map, why_not_solved
from surveysim.forecasting.mode_response import PROJECTIONS
from surveysim.forecasting.noise_model import NoiseModel, forecast_pipelines, is_projection, survey_models
from surveysim.forecasting.observation_weights import expected_weights
from surveysim.forecasting.observing_conditions import (
    ObservingConditions,
    observing_conditions,
    survey_draws,
)
from surveysim.forecasting.pilot import KeptScans, predict_kept_scans
from surveysim.forecasting.response_filters import CLOSED_STEPS
from surveysim.forecasting.time_filters import has_few_modes
from surveysim.forecasting.track_motions import track_motions
from surveysim.forecasting.validity import EffectInputs, NeglectedEffect, neglected_effects
from surveysim.reduction.analysis import AnalysisSetup
from surveysim.reduction.scored_region import left_signal
from surveysim.reduction.setup import Setup
from surveysim.runtime.errors import NotForecastableError
from surveysim.runtime.memory import keep_freed_memory
from surveysim.survey.discarded_scans import REMEDY
from surveysim.timestreams.component import present_components
from surveysim.timestreams.expected_losses import sampled_share
from surveysim.timestreams.response import present_steps

if TYPE_CHECKING:
    from astropy.table import QTable

    from surveysim.runtime.table import Table

NOTHING_FOUND = "score: found no noise in its multipoles or no scan across its patch; both are expected"


@dataclass(frozen=True)
class DataSetForecast:
    """Forecast of one data set.

    Attributes
    ----------
    name, n_det
        Data set and its number of detectors.
    band
        Band power and its uncertainty.
    noise_psd : (n_bin,)
        [uK_CMB^2 sr].
    signal_psd : (n_bin,)
        Expected PSD of a flat spectrum of unit band power [sr].
    transmission : (n_bin,)
        Transfer function of scans and cleaning.
    weights : (n_obs,)
        Inverse noise variance a sample of each observation [1/mK^2].
    kept
        Scans that cleaning keeps.
    effects
        Effects that the forecast neglects, with flags where it is out of its range.
    """

    name: str
    n_det: int
    band: BandPower
    noise_psd: np.ndarray
    signal_psd: np.ndarray
    transmission: np.ndarray
    weights: np.ndarray
    kept: KeptScans
    effects: tuple[NeglectedEffect, ...]


@dataclass(frozen=True)
class Forecast:
    """Forecasts by data set, in bins around `ell` (n_bin,), without best-of-observation sets and without
    non-projections.
    """

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


@threadpool_limits.wrap(limits=1)  # no bit depends on the cores of the machine
def forecast(setup: Setup, kept: dict[str, np.ndarray] | None = None) -> Forecast:
    """Forecast the data sets of a scene.

    Parameters
    ----------
    setup
    kept : dict of (n_obs,), optional
        For the data set of each pipeline, the fraction of scans that a run kept of each of the survey's first
        observations. By default the fractions are predicted by `surveysim.forecasting.pilot`.

    Returns
    -------
    Forecast

    Raises
    ------
    NotForecastableError
        For a scene without [score], with a first cleaning that is not in `PROJECTIONS`, or without noise or scans to
        score.
    """
    keep_freed_memory()
    scene = setup.scene
    if scene.score is None:
        raise NotForecastableError("score: missing; a forecast predicts the score of a map")
    if not is_projection(setup.analysis.pipelines[0]):
        allowed = ", ".join(map(repr, PROJECTIONS))
        raise NotForecastableError(
            f"cleaning.algorithm: found {setup.analysis.pipelines[0].label!r}; one of {allowed} can be forecast"
        )
    if reason := why_no_forecast(setup):
        raise NotForecastableError(reason)
    models = survey_models(setup)
    if kept is None:
        conditions = observing_conditions(setup, survey_draws(setup, 0, scene.observations))
        weight = expected_weights(setup.analysis, _nonzero_noise(setup.analysis, models[0], conditions))
        scans = predict_kept_scans(setup, forecast_pipelines(setup), conditions, weight)
    else:
        conditions = observing_conditions(setup, survey_draws(setup, 0, len(next(iter(kept.values())))))
        scans = {name: KeptScans(share) for name, share in kept.items()}
    found: dict[str, DataSetForecast] = {}
    for model in models:
        if model.name == model.pipeline.data_set:  # the following sets have the same detectors
            hits = mean_hits(setup, model.pipeline)
        elif setup.scene.map.solved:
            continue
        found[model.name] = _scored(setup, model, conditions, kept=scans[model.pipeline.data_set], hits=hits)
    return Forecast(
        setup.analysis.region.rings.ell, {name: found[name] for name in setup.analysis.data_set_names if name in found}
    )


def can_forecast(setup: Setup) -> bool:
    """Tell whether a prepared scene has a score, and closed forms for its components and first cleaning."""
    return setup.scene.score is not None and why_no_forecast(setup) is None


def why_no_forecast(setup: Setup) -> str | None:
    """Name a component, step of the response, cleaning or map-maker without a closed form; None if all have one."""
    for item in present_components(setup.scene):
        if item.name not in CLOSED_FORMS:
            return f"{item.name}: found a section without a closed form"
    for step in present_steps(setup):
        if step.name not in CLOSED_STEPS:
            return f"{step.section}: found a section without a closed form"
    if not is_projection(setup.analysis.pipelines[0]):
        return f"cleaning by {setup.analysis.pipelines[0].label} is no projection"
    if not has_few_modes(setup, setup.analysis.pipelines[0]):
        return f"cleaning by {setup.analysis.pipelines[0].label} has too many modes in scans of this length"
    return why_not_solved(setup)


def _scored(
    setup: Setup, model: NoiseModel, conditions: ObservingConditions, *, kept: KeptScans, hits: np.ndarray
) -> DataSetForecast:
    """Weight and co-add the observations, and score the map."""
    scene, band, rings = setup.scene, setup.analysis.region, setup.analysis.region.rings
    noise, taper, covered = _nonzero_noise(setup.analysis, model, conditions), band.taper**2, hits > 0
    if not taper[covered].any():
        raise NotForecastableError(NOTHING_FOUND)
    if not kept.share.any():
        raise NotForecastableError(
            f"cleaning: rejected all scans {'of a pilot' if kept.error else 'of this run'}; at least one is needed."
            f" {REMEDY}"
        )
    # Hits scale with kept scans and samples; the PSD of a survey scales as one over its observations.
    share = kept.share * sampled_share(scene, conditions.white + conditions.shared)
    if not share.any():
        raise NotForecastableError(f"{', '.join(scene.losses)}: found all samples lost; some are needed")
    weight, signal, layer, taken = expected_weights(setup.analysis, noise), model.signal_psd, None, None
    if scene.map.solved:
        solved = solved_map(setup, model.pipeline, conditions, share)
        variance, weight = solved.noise_mk2 / scene.observations, solved.weight
        noise, layer, taken = solved.each.noise, solved.each.layer, solved.each.taken
        signal = left_signal(
            setup.analysis.beams, setup.analysis.geometry, setup.sky.geometry, band, solved.transmission
        )
    else:
        variance = (weight**2 * share) @ noise / (weight @ share) ** 2 * (len(noise) / scene.observations)
    area = setup.analysis.geometry.pixel_rad**2 * np.sum(taper[covered] / hits[covered]) / np.sum(taper)
    psd = variance * area * (1e3 * scene.instrument.cmb_per_rj) ** 2
    score = band_power(
        psd, signal, rings.n_modes, band.selected, ell=rings.ell, edges_ell=rings.edges_ell, relative_error=0.0
    )
    layer = model.layer_noise(conditions) if layer is None else layer
    of_map = score.weight, hits, track_motions(setup), taken
    inputs = EffectInputs(model.pipeline, model.n_det, conditions, kept, weight, noise, layer, *of_map)
    passed = signal / band.signal_psd
    found = neglected_effects(setup, inputs)
    return DataSetForecast(model.name, model.n_det, score, psd, signal, passed, weight, kept, found)


def _nonzero_noise(analysis: AnalysisSetup, model: NoiseModel, conditions: ObservingConditions) -> np.ndarray:
    """Noise variance a sample (n_draw, n_bin); raises NotForecastableError where a scored multipole has none."""
    noise = model.noise(conditions)
    if not noise[:, analysis.region.selected].all():
        raise NotForecastableError(NOTHING_FOUND)
    return noise
