"""Running and comparing the points of a sweep: ratios with paired errors, and the probability of being the best."""

import math
import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from mapmaker.uncertainty import block_sums, student_factor
from surveysim.forecasting.forecast import Forecast, forecast
from surveysim.metrics.map_noise import Quantity
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import prepare
from surveysim.results.metrics import MetricResult, drawn_metrics
from surveysim.runtime.engine import Engine, ordered_map
from surveysim.runtime.errors import InputError
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.point_run import Keep, PointJob, Stage, forecast_flags, whole
from surveysim.studies.sweep.point_store import PointResult, finished_points, load_point
from surveysim.survey.checkpoint import CheckpointError
from surveysim.survey.discarded_scans import competing
from surveysim.survey.error_modes import Response, error_modes
from surveysim.survey.scores import FEWEST_CONTROLLED, DataSetScore

DRAWS = 20_000  # a probability of 0.5 has an error of 0.004
_DRAWS_AT_ONCE = 1000
SURE = 0.995  # from here on a probability would round to 100 %
_EQUAL = 1e-9  # relative difference below which two points are equal


@dataclass(frozen=True)
class Compared:
    """Quantity that points are compared by: its key, such as "flat_band_power.sigma", its unit and its better side."""

    key: str
    unit: str
    lower_is_better: bool = True


SIGMA_A = Compared(SIGMA_KEY, "uK2")


@dataclass(frozen=True)
class Comparison:
    """Comparison of points, (n_point,) each, NaN for a point without a score.

    Attributes
    ----------
    quantity
        Quantity of the actual data that is compared, by default sigma(A).
    value, error
        The quantity at each point, and its standard error.
    ratio
        The quantity over the one of the point `reference`.
    paired_error, independent_error
        Error of the ratio, and its error if the two points shared no random numbers.
    best
        Points with the best value: several if they are equal, none without a score.
    best_probability
        Probability of being the best among the `competing` points, NaN for other points. Points that lose too many
        scans do not compete (`surveysim.survey.discarded_scans`); if one of these is the best, no point competes.
    modes : (n_point, n_mode)
        Responses of ln value to unit deviates that points may share.
    """

    quantity: Compared
    reference: int | None
    best: tuple[int, ...]
    competing: np.ndarray
    modes: np.ndarray
    value: np.ndarray
    error: np.ndarray
    ratio: np.ndarray
    paired_error: np.ndarray
    independent_error: np.ndarray
    best_probability: np.ndarray


def run_points(
    sweep: Sweep,
    directory: Path | None,
    engine: Engine,
    resume: bool,
    progress: Callable[[int], None],
    keep: Keep | None = None,
) -> tuple[PointResult, ...]:
    """Run all points, several at a time, each on one worker.

    Parameters
    ----------
    directory
        Directory of finished and unfinished points.
    resume
        Continue from the points in `directory`.
    progress
        Function of the number of finished points.
    keep
        Function that writes the results of a point where it runs; None for none.

    Raises
    ------
    CheckpointError
        For files of other scenes.
    EngineError
        If the engine fails.
    ValueError
        If a point fails.
    """
    stages = [whole(point) for point in sweep.points]
    return tuple(run_stages(sweep, stages, directory, engine, resume=resume, progress=progress, keep=keep))


def run_stages(
    sweep: Sweep,
    stages: Sequence[Stage],
    directory: Path | None,
    engine: Engine,
    *,
    resume: bool,
    begun: bool = False,
    progress: Callable[[int], None],
    keep: Keep | None = None,
) -> list[PointResult]:
    """Run points of a sweep to some of their observations; parameters and errors as for `run_points`.

    Points that have `begun` in this run go on from their checkpoints.
    """
    found = _kept(sweep, stages, directory) if resume and directory is not None else {}
    missing = [stage for stage in stages if stage not in found]
    # Workers elsewhere may have another working directory.
    kept = None if directory is None else directory.absolute()
    results = ordered_map(PointJob(kept, resume or begun, keep), missing, engine)
    try:
        for stage in missing:
            found[stage] = next(results)
            progress(len(found))
    finally:
        results.close()
    return [found[stage] for stage in stages]


def _kept(sweep: Sweep, stages: Sequence[Stage], directory: Path) -> dict[Stage, PointResult]:
    """Load finished stages; raises CheckpointError for files of another sweep."""
    for number, path in finished_points(directory).items():
        if number >= len(sweep.points):
            raise CheckpointError(
                f"{path}: from another sweep (this one has {len(sweep.points)} points); "
                "start anew with --force, or write elsewhere with --out"
            )
    there = [stage for stage in stages if os.path.lexists(directory / stage.file)]
    return {stage: load_point(directory / stage.file, stage.point, stage.observations) for stage in there}


def _discarded(found: Forecast | None) -> dict[str, float]:
    """Predicted fractions of discarded scans by data set, without unknown ones."""
    kept = {name: item.kept for name, item in found.scores.items()} if found else {}
    return {name: item.discarded for name, item in kept.items() if np.isfinite(item.error)}


def _kept_error(found: Forecast | None) -> float:
    """Relative error of the predicted scans of the actual data; 0 where it is unknown."""
    kept = found.scores[ACTUAL].kept if found else None
    return kept.error / (1 - kept.discarded) if kept and np.isfinite(kept.error) else 0.0


def forecast_points(sweep: Sweep, progress: Callable[[int], None]) -> tuple[PointResult, ...]:
    """Forecast all points, one after the other, or give the reason for no forecast."""
    results = []
    for point in sweep.points:
        start, found, reason = perf_counter(), None, ""
        try:
            found = forecast(prepare(point.scene))
        except InputError as error:  # a scene without a forecast
            reason = str(error)
        metrics = drawn_metrics(prepare(point.scene), found) if found else {}
        sigma = {name: float(item.band.sigma_ukcmb2) for name, item in found.scores.items()} if found else {}
        told = forecast_flags(found), _discarded(found)
        wall_s = perf_counter() - start
        kept = _kept_error(found)
        results.append(PointResult(point.n_det, 0, {}, sigma, [], *told, [], "", reason, wall_s, {}, metrics, kept))
        progress(len(results))
    return tuple(results)


# ---------------------------------------------------------------- comparison


def of_one_kind(points: tuple[PointResult, ...]) -> tuple[PointResult, ...]:
    """Return the points with comparable estimates: without control variates if one of the points has none.

    The effect of the drawn weather, which a control variate removes, is common to all points of a sweep.
    """
    scored = [item for point in points for item in point.scores.values()]
    if len({item.control is None for item in scored}) < 2:
        return points
    return tuple(
        replace(
            point,
            scores={name: _uncontrolled(item) for name, item in point.scores.items()},
            metrics={name: _plain(found) for name, found in point.metrics.items()},
        )
        for point in points
    )


def _uncontrolled(item: DataSetScore) -> DataSetScore:
    if item.control is None:
        return item
    weather = float(np.hypot(item.budget.weather, item.control.sampling))
    budget = replace(item.budget, weather=weather, population=0.0)
    return replace(item, band=item.plain_band, budget=budget, control=None, plain=None)


def _plain(metrics: dict[str, MetricResult]) -> dict[str, MetricResult]:
    return {key: replace(item, quoted=item.plain) for key, item in metrics.items()}


def compare_runs(
    points: tuple[PointResult, ...], rng: np.random.Generator, reference: int = 0, key: str = SIGMA_KEY
) -> Comparison:
    """Compare runs by a quantity of the actual data, taking common errors into account."""
    value, relative, modes = run_estimates(points, ACTUAL, key)
    shares = actual_shares(points)
    quantity = compared_quantity(key, [point.metrics[ACTUAL][key] for point in points if point.metrics])
    return compare(value, modes, rng, reference=reference, discarded=shares, relative=relative, quantity=quantity)


def run_estimates(points: Sequence[PointResult], data_set: str, key: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a quantity of a data set in runs of one seed (n_point,), NaN without one.

    Its relative errors (n_point,) and `error_modes` (n_point, n_mode) follow.
    """
    found = {number: point.metrics.get(data_set, {}).get(key) for number, point in enumerate(points)}
    scored = {number: item for number, item in found.items() if item and 0 < item.value < np.inf}
    value, relative = np.full((2, len(points)), np.nan)
    modes = np.zeros((len(points), 1))
    if scored:
        numbers = list(scored)
        items = [points[number].scores[data_set] for number in numbers]
        responses = [item.quoted.response for item in scored.values()]
        value[numbers] = [item.value for item in scored.values()]
        relative[numbers] = [response.budget.total for response in responses]
        rows = error_modes(items, [points[number].skies for number in numbers], _of_one_weather(items, responses))
        modes = np.zeros((len(points), rows.shape[1]))
        modes[numbers] = rows
    return value, relative, modes


def compared_quantity(key: str, items: Iterable[MetricResult | Quantity]) -> Compared:
    """Quantity of these values; without any, its unit is unknown."""
    first = next(iter(items), None)
    return Compared(key, first.unit, first.lower_is_better) if first else Compared(key, "")


def _of_one_weather(items: list[DataSetScore], responses: list[Response]) -> list[Response]:
    """Return responses for comparisons: with equal numbers of observations, the weather is common to all.

    The error from few weather draws may be unknown, but it cancels in ratios: the remaining part shows in the scatter
    between the observations of two points.
    """
    lengths = {len(item.weights) for item in items}
    if len(lengths) > 1 or min(lengths) < FEWEST_CONTROLLED or any(item.control is not None for item in items):
        return responses
    return [
        replace(response, budget=replace(response.budget, weather=_scatter(item, response)))
        for item, response in zip(items, responses, strict=True)
    ]


def _scatter(item: DataSetScore, response: Response) -> float:
    if not (np.isfinite(response.noise).all() and response.noise.any()):
        return response.budget.weather
    shares = block_sums(item.shares(response.noise, response.exponent), item.block)
    if len(shares) < FEWEST_CONTROLLED:
        return math.nan
    return float(np.std(shares, ddof=1) * len(shares) ** 0.5) * student_factor(len(shares))


def actual_shares(points: tuple[PointResult, ...]) -> np.ndarray:
    """Return the fractions (n_point,) of discarded scans of the actual data, 0 if unknown."""
    return np.array([point.discarded.get(ACTUAL, 0.0) for point in points])


def compare_forecasts(points: tuple[PointResult, ...], reference: int = 0, key: str = SIGMA_KEY) -> Comparison:
    """Compare forecasts by a quantity of the actual data; they have no Monte Carlo errors."""
    found = [point.metric_forecasts.get(ACTUAL, {}).get(key) for point in points]
    value = np.array([item.value if item and 0 < item.value < np.inf else np.nan for item in found])
    rng, quantity = np.random.default_rng(0), compared_quantity(key, filter(None, found))
    return compare(value, np.zeros((len(points), 1)), rng, reference=reference, quantity=quantity)


def compare(
    value: np.ndarray,
    modes: np.ndarray,
    rng: np.random.Generator,
    *,
    reference: int = 0,
    discarded: np.ndarray | None = None,
    relative: np.ndarray | None = None,
    quantity: Compared = SIGMA_A,
) -> Comparison:
    """Compare points (n_point,), NaN without a score.

    Parameters
    ----------
    value : (n_point,)
    modes : (n_point, n_mode)
        Responses of ln value to unit deviates. Points with NaN do not compete.
    reference
        Number of the reference point; without a score, the first point with one replaces it.
    discarded : (n_point,), optional
        Fractions of discarded scans, by default none.
    relative : (n_point,), optional
        Relative errors, NaN if unknown; by default those of the modes.
    quantity
        The quantity.
    """
    scored = np.flatnonzero(np.isfinite(value))
    nothing, competes = np.full(len(value), np.nan), np.zeros(len(value), bool)
    if len(scored) == 0:
        return Comparison(quantity, None, (), competes, modes, *(nothing.copy() for _ in range(6)))
    reference = reference if reference in scored else int(scored[0])
    cost = value if quantity.lower_is_better else 1 / value
    best = tuple(int(number) for number in scored[cost[scored] <= np.nanmin(cost) * (1 + _EQUAL)])
    shares = np.zeros(len(nothing)) if discarded is None else discarded
    competes[scored] = competing(shares[scored]) & np.isfinite(modes[scored]).all(axis=1)
    # No point is known to be the best alone, or if a point that does not compete is better.
    if competes.sum() < 2 or not competes[list(best)].any():
        competes[:] = False
    relative = np.linalg.norm(modes, axis=1) if relative is None else relative
    ratio = value / value[reference]
    apart = np.hypot(relative, relative[reference])
    paired = np.linalg.norm(modes - modes[reference], axis=1)
    apart[reference] = paired[reference] = 0.0
    probability = nothing.copy()
    if competes.any():
        probability[competes] = probability_of_lowest(np.log(cost[competes]), modes[competes], rng)
    return Comparison(
        quantity=quantity,
        reference=reference,
        best=best,
        competing=competes,
        modes=modes,
        value=value,
        error=value * relative,
        ratio=ratio,
        paired_error=ratio * paired,
        independent_error=ratio * apart,
        best_probability=probability,
    )


def probability_of_lowest(log_cost: np.ndarray, modes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Compute the probability (n,) that each true value is the lowest, from `DRAWS` draws about the measured values.

    Equal values share a draw.
    """
    # As many modes as points are enough: R^T R = modes modes^T.
    factor = np.linalg.qr(modes.T, mode="r")
    won = np.zeros(len(log_cost))
    for _ in range(DRAWS // _DRAWS_AT_ONCE):
        drawn = log_cost + rng.standard_normal((_DRAWS_AT_ONCE, len(factor))) @ factor
        lowest = drawn <= drawn.min(axis=1, keepdims=True) + _EQUAL
        won += (lowest / lowest.sum(axis=1, keepdims=True)).sum(axis=0)
    return won / DRAWS
