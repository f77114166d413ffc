"""Forecast of the map-makers that solve for a map: noise, transfer function and weights of observations."""

from dataclasses import dataclass

import numpy as np

from mapmaker.cleaning import TIME_FILTERS
from surveysim.forecasting.destriped import destriped_noise
from surveysim.forecasting.likelihood import COMPONENTS, MOST_DETECTORS, STEPS, likelihood_sums
from surveysim.forecasting.observation_weights import expected_weights
from surveysim.forecasting.observing_conditions import ObservingConditions
from surveysim.forecasting.solved_maps import ObservationNoise, solved_bins
from surveysim.forecasting.track_motions import track_motions
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.noise_weights import baseline_samples, noise_options
from surveysim.reduction.setup import Setup
from surveysim.timestreams.component import present_components
from surveysim.timestreams.response import present_steps


@dataclass(frozen=True, eq=False)
class SolvedMapNoise:
    """Noise of a map that is solved for.

    Attributes
    ----------
    noise_mk2 : (n_bin,)
        Noise variance a sample of a mean observation.
    transmission : (n_bin,)
        Transfer function of scans, cleaning and map-maker.
    weight : (n_obs,)
        Inverse noise variance of the observations [1/mK^2].
    each
        Noise of each observation.
    """

    noise_mk2: np.ndarray
    transmission: np.ndarray
    weight: np.ndarray
    each: ObservationNoise


def solved_map(
    setup: Setup, pipeline: CleaningPipeline, conditions: ObservingConditions, share: np.ndarray
) -> SolvedMapNoise:
    """Forecast the map of a survey with fractions of kept samples (n_obs,), by the map-maker of the scene."""
    tracks = track_motions(setup)
    if setup.scene.map.maker == "destriped":
        found = destriped_noise(setup, pipeline, conditions, baseline_samples(setup))
        weight = expected_weights(setup.analysis, found.each.noise)
        return SolvedMapNoise(*solved_bins(found.modes, found.sums(weight, share), tracks), weight, found.each)
    options = noise_options(setup.scene.map)
    modes, sums, each = likelihood_sums(setup, pipeline, conditions, share, options)
    return SolvedMapNoise(*solved_bins(modes, sums, tracks), expected_weights(setup.analysis, each.noise), each)


def single_observations(setup: Setup, pipeline: CleaningPipeline, conditions: ObservingConditions) -> np.ndarray:
    """Noise variance a sample (n_obs, n_bin) of the maps of single observations, by the map-maker of the scene."""
    if setup.scene.map.maker == "destriped":
        return destriped_noise(setup, pipeline, conditions, baseline_samples(setup)).each.noise
    share = np.ones(len(conditions.sine))
    return likelihood_sums(setup, pipeline, conditions, share, noise_options(setup.scene.map))[2].noise


def why_not_solved(setup: Setup) -> str | None:
    """Name what a maximum-likelihood map of a scene has that has no closed form; None if nothing, or another maker."""
    if setup.scene.map.maker != "maximum_likelihood":
        return None
    present = [item.name for item in present_components(setup.scene)] + [step.name for step in present_steps(setup)]
    if wrong := [name for name in present if name not in (*COMPONENTS, *STEPS)]:
        return f"{wrong[0]}: found without a closed form for maximum-likelihood maps"
    if filters := [name for name in setup.scene.cleaning.algorithm if name in TIME_FILTERS]:
        return f"cleaning by {filters[0]!r} has no closed form for maximum-likelihood maps"
    if setup.camera.n_det > MOST_DETECTORS:
        return f"{setup.camera.n_det} detectors in a maximum-likelihood map; {MOST_DETECTORS} or fewer can be forecast"
    return None
