"""Scores of a run from its observations so far."""

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup
from surveysim.results.control_variate import quoted_scores
from surveysim.results.metrics import relative_error
from surveysim.results.stopping import Estimate, best_estimate
from surveysim.runtime.errors import InsufficientDataError
from surveysim.survey.coadds import CoAdds


def estimate_so_far(setup: Setup, coadds: CoAdds) -> Estimate | None:
    """Return the best estimate from the observations so far; None without one."""
    if setup.scene.map.solved and not coadds.convergence:
        return None
    try:
        return best_estimate(quoted_scores(setup, coadds, (ACTUAL,)))
    except InsufficientDataError:  # too few scans are kept so far
        return None


def error_so_far(setup: Setup, coadds: CoAdds, metric: str) -> float | None:
    """Return the relative error of a metric of the actual data from the observations so far; None without a score."""
    try:
        return relative_error(setup, quoted_scores(setup, coadds, (ACTUAL,))[ACTUAL], metric)
    except InsufficientDataError:  # too few scans are kept so far
        return None
