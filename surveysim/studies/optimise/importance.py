"""Sobol' indices: how much of the variance of a metric over the knobs' ranges each knob makes."""

from dataclasses import dataclass

import numpy as np

from surveysim.studies.optimise.evaluation import Evaluation
from surveysim.studies.optimise.search import Objective
from surveysim.studies.optimise.store import EvaluationStore

SEED = 0
RESAMPLES = 200
ONE_SIGMA = 0.6827


@dataclass(frozen=True)
class Importance:
    """Sobol' indices of the ln of a metric over the knobs' ranges, (n_knob,) each, with bootstrap errors.

    Attributes
    ----------
    first, total
        First-order index: the part of the variance that the knob makes alone; total index: with its interactions.
    first_error, total_error
        Half the width of the interval of 68 %.
    samples, refused
        Designs that were evaluated, and those without a forecast, which count as the mean of the others.
    """

    first: np.ndarray
    first_error: np.ndarray
    total: np.ndarray
    total_error: np.ndarray
    samples: int
    refused: int


def importance(store: EvaluationStore, objective: Objective, n: int) -> Importance:
    """Evaluate n (n_knob + 2) designs and compute Sobol' indices (Saltelli et al. 2010); n is a power of two.

    Raises
    ------
    SpentError
        When the problem's number of evaluations is spent.
    """
    from scipy.stats import sobol_indices, uniform

    found: list[Evaluation] = []

    def values(places: np.ndarray) -> np.ndarray:
        items = store.all_at([tuple(column) for column in places.T.tolist()])
        found.extend(items)
        made = np.array([objective(item) if item.metrics else np.nan for item in items])
        return np.where(np.isnan(made), np.nanmean(made), made)[None]

    knobs = len(store.problem.knobs)
    result = sobol_indices(func=values, n=n, dists=[uniform()] * knobs, rng=np.random.default_rng(SEED))
    spread = result.bootstrap(confidence_level=ONE_SIGMA, n_resamples=RESAMPLES)
    half = [
        (item.confidence_interval.high - item.confidence_interval.low) / 2
        for item in (spread.first_order, spread.total_order)
    ]
    refused = sum(not item.metrics for item in found)
    first, total = np.ravel(result.first_order), np.ravel(result.total_order)
    return Importance(first, np.ravel(half[0]), total, np.ravel(half[1]), len(found), refused)
