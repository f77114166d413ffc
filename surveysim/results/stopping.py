"""Stopping criteria of a run, its best estimate, and the cost of a smaller error.

A run stops early if its error is small enough or its time is spent. The decision about the error depends on sums over
fixed numbers of observations only, never on workers or clocks.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup, signal_sim_observations
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.metrics import SIGMA_KEY, metric_keys
from surveysim.scene.scene import Scene
from surveysim.scene.units import shown, to_float
from surveysim.survey.coadd_tree import CoAddTree
from surveysim.survey.coadds import CoAdds
from surveysim.survey.scores import DataSetScore, noise_parts

FEWEST = 32  # observations whose scatter gives the error to an eighth, among them rare ones that lose scans
_FEWEST_WITH_SIMS = 8  # fewest observations with simulated signal: fewer leave seams in the maps of the sky
_SPACING = 8  # observations between boundaries, up to 128: four pairs of scan directions
FINE_ERROR = 0.01  # relative error whose cost is printed
TOLD_ERRORS = (0.03, FINE_ERROR)  # relative errors whose costs are in summary.json
_SHARE = 0.25  # largest fraction of the target variance from sign flips, or from skies


@dataclass(frozen=True)
class StoppingCriteria:
    """Criteria that end a run before its last observation.

    Parameters
    ----------
    target_error : float, optional
        Relative error of the metric.
    time_budget_s : float, optional
        Time [s] since the start.
    metric : str
        Key of a quantity of the actual data, by default sigma(A).
    in_rounds : bool
        Whether the rounds of a sweep end the run.
    """

    target_error: float | None = None
    time_budget_s: float | None = None
    metric: str = SIGMA_KEY
    in_rounds: bool = False

    def __post_init__(self) -> None:
        """Raise InputError for an error that is not between 0 and 1 or a time that is not above 0."""
        target, budget = self.target_error, self.time_budget_s
        if target is not None and not 0 < target < 1:
            raise InputError(f"target error: found {target:g}; more than 0 and less than 100 % is expected")
        if budget is not None and not 0 < budget < math.inf:
            raise InputError(f"time budget: found {budget:g} s; more than 0 s is expected")


UNLIMITED = StoppingCriteria()


@dataclass(frozen=True)
class Estimate:
    """Quoted sigma(A) [uK_CMB^2] of the actual data for the whole survey, with its error.

    `kind` is "controlled", with the forecast as control variate, or "plain". `plain_sigma_ukcmb2` and
    `plain_error_ukcmb2` are without a control variate. Unknown errors are NaN.
    """

    kind: str
    sigma_ukcmb2: float
    error_ukcmb2: float
    plain_sigma_ukcmb2: float
    plain_error_ukcmb2: float

    @property
    def relative_error(self) -> float:
        """Error over sigma."""
        return self.error_ukcmb2 / self.sigma_ukcmb2


@dataclass(frozen=True)
class TimeToPrecision:
    """Cost of sigma(A) to a relative error.

    Parameters
    ----------
    relative_error : float
        Relative error of sigma(A).
    seconds : float
        Time of simulation [s].
    observations, jackknives, skies : int
        Values of the scene: observations, sign flips, simulated skies.
    """

    relative_error: float
    seconds: float
    observations: int
    jackknives: int
    skies: int


def parsed_limits(target_error: str | None, time_budget: str | None, metric: str | None = None) -> StoppingCriteria:
    """Parse limits from texts such as "3%" or "0.03" and "60 s" or "2 min"; raise InputError for other texts."""
    if metric is not None and target_error is None:
        raise InputError("--target-metric: found no --target-error, which is of this metric")
    parsed = []
    for name, text, unit in (("--target-error", target_error, ""), ("--time-budget", time_budget, "s")):
        try:
            parsed.append(None if text is None else to_float(text, unit))
        except InputError as error:
            raise InputError(f"{name}: {error}") from None
    target, budget = parsed
    return StoppingCriteria(target, budget, metric or SIGMA_KEY)


def check_limits(setup: Setup, limits: StoppingCriteria) -> None:
    """Raise SceneError for a target error without a score in the scene, or of a metric that the scene lacks."""
    score = setup.scene.score
    if limits.target_error is None:
        return
    if score is None:
        raise SceneError("score: missing; a target error is one of a score, which needs it")
    if setup.scene.map.maker != "binned":
        raise SceneError(
            f"map.maker: found {setup.scene.map.maker!r} with a target error; 'binned' is expected, whose error is"
            " known before the last observation"
        )
    if limits.metric not in (known := metric_keys(score.metrics)):
        raise SceneError(f"target metric: found {shown(limits.metric)}; one of {', '.join(known)} is expected")


def stopping_rule(setup: Setup, limits: StoppingCriteria, begun: float) -> Callable[[CoAddTree], bool] | None:
    """Make the function that decides whether a run that was `begun` (by `perf_counter`) stops at given sums.

    The target is checked at the boundaries of `may_end`, the budget after each pair of scan directions. None without
    limits.
    """
    if limits == UNLIMITED:
        return None

    def stops(sums: CoAddTree) -> bool:
        if limits.target_error is not None and may_end(setup.scene, sums.done):
            from surveysim.results.so_far import error_so_far

            error = error_so_far(setup, sums.so_far(), limits.metric)
            if error is not None and error <= limits.target_error:
                return True
        over = limits.time_budget_s is not None and perf_counter() - begun >= limits.time_budget_s
        return over and sums.done > 0 and sums.done % 2 == 0

    return stops


def may_end(scene: Scene, done: int) -> bool:
    """Return whether a run may end by its target here: at a boundary, with enough simulated signal."""
    with_sims = signal_sim_observations(scene)
    return is_boundary(done) and with_sims[:done].sum() >= min(_FEWEST_WITH_SIMS, with_sims.sum())


def is_boundary(done: int) -> bool:
    """Return whether a run may end here by its error: every 8 observations from 32 on, 16 from 128, 32 from 256, ..."""
    return done >= FEWEST and done % (_SPACING * 2 ** max(0, done.bit_length() - 7)) == 0


def stop_reason(setup: Setup, limits: StoppingCriteria, done: int, error: float | None) -> str:
    """Return the reason for the end of a run: "all" observations, its "target", its time "budget" or its "sweep".

    `error` is the relative error of the metric of the limits, None without a score.
    """
    if done == setup.scene.observations:
        return "all"
    if limits.in_rounds:
        return "sweep"
    reached = error is not None and limits.target_error is not None and error <= limits.target_error
    return "target" if reached and may_end(setup.scene, done) else "budget"


def best_estimate(scores: dict[str, DataSetScore]) -> Estimate | None:
    """Return the quoted estimate of the actual data; None without a score."""
    if ACTUAL not in scores:
        return None
    item = scores[ACTUAL]
    kind = "plain" if item.control is None else "controlled"
    bands = item.band, item.plain_band
    return Estimate(kind, *(value for band in bands for value in (band.sigma_ukcmb2, band.error_ukcmb2)))


@dataclass(frozen=True)
class ErrorParts:
    """Parts of the relative error of the actual data's best estimate.

    Parameters
    ----------
    observations, flips, skies : float
        Parts that fall with more observations, sign flips and simulated skies.
    rest : float
        Part that falls with none of them.
    each_s : float
        Time [s] of one observation on one worker.
    """

    observations: float
    flips: float
    skies: float
    rest: float
    each_s: float


def error_parts(setup: Setup, coadds: CoAdds, scores: dict[str, DataSetScore]) -> ErrorParts:
    """Return the parts of the error of a run whose actual data are scored."""
    item = scores[ACTUAL]
    flips, common = noise_parts(setup.analysis, item)
    budget = item.budget
    return ErrorParts(
        math.hypot(common, budget.weather), flips, budget.transfer_function, budget.population, coadds.each_s
    )


def answer_cost(
    setup: Setup, done: int, workers: int, parts: ErrorParts, target: float = FINE_ERROR
) -> TimeToPrecision | None:
    """Predict the cost of sigma(A) to a relative error from the parts of a run's error.

    Errors from sign flips and simulated skies do not fall with observations. If they exceed a quarter of the target's
    variance, their numbers are increased; these errors fall as the inverse root of the numbers.

    Parameters
    ----------
    setup : Setup
        Setup of the run.
    done, workers : int
        Number of simulated observations, and of workers.
    parts : ErrorParts
        Parts of the error.
    target : float
        Relative error.

    Returns
    -------
    TimeToPrecision or None
        None if the rest of the error exceeds the target, or the error is unknown.
    """
    score = setup.scene.score
    if math.isnan(parts.observations):
        return None
    jackknives = _enough(score.jackknives, parts.flips / target)
    skies = _enough(score.signal_sims.skies, parts.skies / target)
    fixed = (
        parts.flips**2 * score.jackknives / jackknives
        + parts.skies**2 * score.signal_sims.skies / skies
        + parts.rest**2
    )
    if fixed >= target**2:
        return None
    observations = 2 * max(1, math.ceil(done * parts.observations**2 / (target**2 - fixed) / 2))
    return TimeToPrecision(target, observations * parts.each_s / workers, observations, jackknives, skies)


def _enough(number: int, error: float) -> int:
    """Return the number needed where this one gives an error in units of the target."""
    return max(number, math.ceil(number * error**2 / _SHARE))
