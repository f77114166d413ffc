"""Pilot of a survey: a few scans are simulated and cleaned to predict the fraction of scans that cleaning rejects."""

from dataclasses import dataclass, replace

import numpy as np

from mapmaker.cleaning.responsivity import OBSERVATION
from surveysim.forecasting.observing_conditions import ObservingConditions
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.observation import kept_scans
from surveysim.reduction.setup import Setup
from surveysim.runtime.errors import InputError
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.scan_blocks import Block
from surveysim.timestreams.simulation import ObservingSetup

MOST_OBSERVATIONS = 32  # of a pilot
MOST_SCANS = 6  # of each, for `MOST_OBSERVATIONS` of them
_SAMPLES = 3e6  # detector-samples of a pilot: about a quarter of a second
_FEWEST_OBSERVATIONS = 8  # even where these have more than `_SAMPLES`
_MOST_SAMPLES = 5e7  # of any pilot: a few seconds


@dataclass(frozen=True)
class KeptScans:
    """Scans that cleaning keeps.

    Attributes
    ----------
    share : (n_obs,)
        Fraction of its scans that each observation keeps.
    error
        Standard error of `discarded`: 0 where all scans were counted, infinite where the fraction is unknown and set to
        1.
    """

    share: np.ndarray
    error: float = 0.0

    @property
    def discarded(self) -> float:
        """Fraction of the survey's scans that is discarded."""
        return float(1 - self.share.mean())


def predict_kept_scans(
    setup: Setup, pipelines: tuple[CleaningPipeline, ...], conditions: ObservingConditions, weight: np.ndarray
) -> dict[str, KeptScans]:
    """Predict the scans that cleaning keeps, by data set, with a pilot.

    Observations are sorted by the amplitude of the layer. The pilot takes them at equal steps, half in number and half
    in `weight`: scans are rejected in calm weather, whose observations have the largest weights. Between the
    observations of the pilot the fraction is interpolated. Pipelines without responsivity fits keep all scans. Where
    the pilot would take more than a few seconds, or can't be drawn, the fraction is unknown. One fit to all scans of
    an observation is then tried with fewer of them. The mean power of the layer scatters more over few scans than over
    many, so that more fits fail; where all converge, all scans are taken as kept. Draws are those of the scene's seed.

    Parameters
    ----------
    setup
    pipelines
        Pipelines of the forecast.
    conditions
        Observing conditions of the observations.
    weight : (n_obs,)
        Weights of the observations in the map.

    Returns
    -------
    dict of KeptScans
        By data set of each pipeline.
    """
    whole = KeptScans(np.ones(len(weight)))
    fitted = tuple(pipeline for pipeline in pipelines if pipeline.takes_responsivities)
    if not setup.scene.turbulent or setup.analysis.calibration is not None or not fitted:
        return {pipeline.data_set: whole for pipeline in pipelines}
    unknown = {
        pipeline.data_set: replace(whole, error=np.inf) if pipeline in fitted else whole for pipeline in pipelines
    }
    scan_samples = setup.camera.n_det * samples_per_scan(setup.observing.scans)
    n_scans, n_pilot = _pilot_size(setup.observing, scan_samples, len(weight))
    drawn = min(n_scans, int(_MOST_SAMPLES // (n_pilot * scan_samples)))
    if not drawn:
        return unknown
    order = np.argsort(conditions.layers.sum(axis=0), kind="stable")
    importance = np.cumsum(weight[order] / weight.sum() + 1 / len(weight)) / 2
    places = np.unique(np.searchsorted(importance, (np.arange(n_pilot) + 0.5) / n_pilot))
    places = np.minimum(places, len(weight) - 1)
    pilot = replace(
        setup,
        observing=replace(setup.observing, blocks=(Block(0, 0, drawn),)),
        analysis=replace(setup.analysis, pipelines=fitted),
    )
    try:
        found = np.array([kept_scans(pilot, int(order[place])).mean(axis=1) for place in places])
    except InputError:  # a layer that can't be drawn
        return unknown
    if drawn < n_scans and not (found == 1).all():
        return unknown
    shares = {
        pipeline.data_set: _interpolate_shares(order, places, of, n_scans if drawn == n_scans else 1)
        for pipeline, of in zip(fitted, found.T, strict=True)
    }
    return {pipeline.data_set: shares.get(pipeline.data_set, whole) for pipeline in pipelines}


def _pilot_size(observing: ObservingSetup, scan_samples: int, n_obs: int) -> tuple[int, int]:
    """Numbers of scans an observation and of observations in a pilot; scans that share one fit are all included."""
    scans, most = _SAMPLES / scan_samples, min(MOST_OBSERVATIONS, n_obs)
    n_scans = int(np.clip(scans / most, 1, MOST_SCANS * MOST_OBSERVATIONS / most))
    if observing.scene.cleaning.responsivities == OBSERVATION:
        n_scans = observing.scans.n_scans
    n_pilot = int(np.clip(scans / n_scans, _FEWEST_OBSERVATIONS, MOST_OBSERVATIONS))
    return min(n_scans, observing.scans.n_scans), min(n_pilot, n_obs)


def _interpolate_shares(order: np.ndarray, places: np.ndarray, found: np.ndarray, n_scans: int) -> KeptScans:
    """Interpolate the kept fractions `found` in the pilot's observations, of `n_scans` scans each, to all observations.

    The error follows from the scatter of neighbours, whose weather is similar, and is at least one scan of all.
    """
    share = np.empty(len(order))
    share[order] = np.interp(np.arange(len(order)), places, found)
    edges = np.concatenate([[0], (places[1:] + places[:-1] + 1) / 2, [len(order)]])
    stands_for = np.diff(edges) / len(order)
    scatter = np.sqrt(np.mean(np.diff(found) ** 2) / 2) if len(found) > 1 else 0.5
    error = max(scatter * np.linalg.norm(stands_for), 1 / (n_scans * len(found)))
    return KeptScans(share, float(error))
