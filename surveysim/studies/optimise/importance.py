"""Sobol' indices: how much of the variance of a metric over the knobs' ranges each knob makes."""

from dataclasses import dataclass

import numpy as np

from surveysim.studies.optimise.search import Objective
from surveysim.studies.optimise.store import EvaluationStore

SEED = 0
RESAMPLES = 200


@dataclass(frozen=True)
class Importance:
    """Sobol' indices of the ln of a metric over the knobs' ranges, (n_knob,) each, with bootstrap errors.

    Attributes
    ----------
    first, total
        First-order index: the part of the variance that the knob makes alone; total index: with its interactions.
    first_error, total_error
        Standard deviations over bootstrap samples.
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
    from scipy.stats import qmc

    rng, knobs = np.random.default_rng(SEED), len(store.problem.knobs)
    both = qmc.Sobol(2 * knobs, rng=rng).random(n)
    first, second = both[:, :knobs], both[:, knobs:]
    mixed = np.repeat(first[None], knobs, axis=0)
    for number in range(knobs):
        mixed[number, :, number] = second[:, number]
    places = np.concatenate([first, second, *mixed])
    found = store.all_at(tuple(row) for row in places.tolist())
    values = np.array([objective(item) if item.metrics else np.nan for item in found])
    values = np.where(np.isnan(values), np.nanmean(values), values).reshape(knobs + 2, n)
    draws = np.array([_indices(values[:, rng.integers(0, n, n)]) for _ in range(RESAMPLES)])
    (alone, total), (alone_error, total_error) = _indices(values), draws.std(axis=0)
    return Importance(alone, alone_error, total, total_error, len(found), sum(not item.metrics for item in found))


def _indices(values: np.ndarray) -> np.ndarray:
    """First-order and total indices (2, n_knob) of objectives (n_knob + 2, n) of two samples and their mixtures."""
    from scipy.stats import sobol_indices

    given = {"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:, None]}
    result = sobol_indices(func=given, n=values.shape[1])
    return np.array([np.ravel(result.first_order), np.ravel(result.total_order)])
