"""Running and comparing the points of a sweep: ratios with paired errors, and the probability of being the best."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from mapmaker.uncertainty import ratio_error, student_factor
from surveysim.forecasting.forecast import Forecast, forecast
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import Engine, ordered_map
from surveysim.runtime.errors import InputError
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.point_run import Keep, PointJob, forecast_flags, whole
from surveysim.studies.sweep.point_store import PointResult, finished_points, load_point
from surveysim.survey.checkpoint import CheckpointError
from surveysim.survey.discarded_scans import competing
from surveysim.survey.error_modes import error_modes
from surveysim.survey.scores import FEWEST_CONTROLLED, DataSetScore

DRAWS = 20_000  # a probability of 0.5 has an error of 0.004
_DRAWS_AT_ONCE = 1000
SURE = 0.995  # from here on a probability would round to 100 %
_EQUAL = 1e-9  # relative difference below which two points are equal


@dataclass(frozen=True)
class Comparison:
    """Comparison of points, (n_point,) each, NaN for a point without a score.

    Attributes
    ----------
    ratio
        sigma(A) over sigma(A) of the point `reference`.
    paired_error, independent_error
        Error of the ratio, and its error if the two points shared no random numbers.
    best
        Points with the lowest sigma(A): several if they are equal, none without a score.
    best_probability
        Probability of being the lowest among the `competing` points, NaN for other points. Points that lose too many
        scans do not compete (`surveysim.survey.discarded_scans`); if one of these is the lowest, no point competes.
    modes : (n_point, n_mode)
        Responses of ln sigma to unit deviates that points may share.
    """

    reference: int | None
    best: tuple[int, ...]
    competing: np.ndarray
    modes: np.ndarray
    sigma_ukcmb2: np.ndarray
    error_ukcmb2: np.ndarray
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
        Function that writes the results of a point where it runs, by its number; None for none.

    Raises
    ------
    CheckpointError
        For files of other scenes.
    EngineError
        If the engine fails.
    ValueError
        If a point fails.
    """
    found = _kept(sweep, directory) if resume and directory is not None else {}
    missing = [whole(point) for point in sweep.points if point.number not in found]
    # Workers elsewhere may have another working directory.
    kept = None if directory is None else directory.absolute()
    results = ordered_map(PointJob(kept, resume, keep), missing, engine)
    try:
        for stage in missing:
            found[stage.point.number] = next(results)
            progress(len(found))
    finally:
        results.close()
    return tuple(found[point.number] for point in sweep.points)


def _kept(sweep: Sweep, directory: Path) -> dict[int, PointResult]:
    """Load finished points by number; raises CheckpointError for files of another sweep."""
    found = {}
    for number, path in finished_points(directory).items():
        if number >= len(sweep.points):
            raise CheckpointError(
                f"{path}: from another sweep (this one has {len(sweep.points)} points); "
                "start anew with --force, or write elsewhere with --out"
            )
        found[number] = load_point(path, sweep.points[number])
    return found


def _discarded(found: Forecast | None) -> dict[str, float]:
    """Predicted fractions of discarded scans by data set, without unknown ones."""
    kept = {name: item.kept for name, item in found.scores.items()} if found else {}
    return {name: item.discarded for name, item in kept.items() if np.isfinite(item.error)}


def forecast_points(sweep: Sweep, progress: Callable[[int], None]) -> tuple[PointResult, ...]:
    """Forecast all points, one after the other, or give the reason for no forecast."""
    results = []
    for point in sweep.points:
        start, found, reason = perf_counter(), None, ""
        try:
            found = forecast(prepare(point.scene))
        except InputError as error:  # a scene without a forecast
            reason = str(error)
        sigma = {name: float(item.band.sigma_ukcmb2) for name, item in found.scores.items()} if found else {}
        told = forecast_flags(found), _discarded(found)
        results.append(PointResult(point.n_det, 0, {}, sigma, [], *told, [], "", reason, perf_counter() - start))
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
        replace(point, scores={name: _uncontrolled(item) for name, item in point.scores.items()}) for point in points
    )


def _uncontrolled(item: DataSetScore) -> DataSetScore:
    if item.control is None:
        return item
    weather = float(np.hypot(item.budget.weather, item.control.sampling))
    budget = replace(item.budget, weather=weather, population=0.0)
    return replace(item, band=item.plain_band, budget=budget, control=None, plain=None)


def compare_runs(points: tuple[PointResult, ...], rng: np.random.Generator, reference: int = 0) -> Comparison:
    """Compare runs of the actual data, taking common errors into account."""
    scored = {number: point.scores[ACTUAL] for number, point in enumerate(points) if point.scores}
    sigma, relative = np.full((2, len(points)), np.nan)
    modes = np.zeros((len(points), 1))
    if scored:
        numbers, items = list(scored), list(scored.values())
        sigma[numbers] = [item.band.sigma_ukcmb2 for item in items]
        relative[numbers] = [item.band.error_ukcmb2 / item.band.sigma_ukcmb2 for item in items]
        found = error_modes(_of_one_weather(items), [points[number].skies for number in numbers])
        modes = np.zeros((len(points), found.shape[1]))
        modes[numbers] = found
    return compare(sigma, modes, rng, reference=reference, discarded=actual_shares(points), relative=relative)


def _of_one_weather(items: list[DataSetScore]) -> list[DataSetScore]:
    """Return scores for comparisons: with equal numbers of observations, the weather is common to all.

    The error from few weather draws may be unknown, but it cancels in ratios: the remaining part shows in the scatter
    between the observations of two points.
    """
    lengths = {len(item.weights) for item in items}
    if len(lengths) > 1 or min(lengths) < FEWEST_CONTROLLED or any(item.control is not None for item in items):
        return items
    return [replace(item, budget=replace(item.budget, weather=_scatter(item.information))) for item in items]


def _scatter(information: np.ndarray) -> float:
    return ratio_error(information, np.ones(len(information))) * student_factor(len(information))


def actual_shares(points: tuple[PointResult, ...]) -> np.ndarray:
    """Return the fractions (n_point,) of discarded scans of the actual data, 0 if unknown."""
    return np.array([point.discarded.get(ACTUAL, 0.0) for point in points])


def compare_forecasts(points: tuple[PointResult, ...], reference: int = 0) -> Comparison:
    """Compare forecasts of the actual data, which have no Monte Carlo errors."""
    sigma = np.array([point.forecast_ukcmb2.get(ACTUAL, np.nan) for point in points])
    return compare(sigma, np.zeros((len(points), 1)), np.random.default_rng(0), reference=reference)


def compare(
    sigma_ukcmb2: np.ndarray,
    modes: np.ndarray,
    rng: np.random.Generator,
    *,
    reference: int = 0,
    discarded: np.ndarray | None = None,
    relative: np.ndarray | None = None,
) -> Comparison:
    """Compare points (n_point,), NaN without a score.

    Parameters
    ----------
    sigma_ukcmb2 : (n_point,)
    modes : (n_point, n_mode)
        Responses of ln sigma to unit deviates. Points with NaN do not compete.
    reference
        Number of the reference point; without a score, the first point with one replaces it.
    discarded : (n_point,), optional
        Fractions of discarded scans, by default none.
    relative : (n_point,), optional
        Relative errors, NaN if unknown; by default those of the modes.
    """
    scored = np.flatnonzero(np.isfinite(sigma_ukcmb2))
    nothing, competes = np.full(len(sigma_ukcmb2), np.nan), np.zeros(len(sigma_ukcmb2), bool)
    if len(scored) == 0:
        return Comparison(None, (), competes, modes, *(nothing.copy() for _ in range(6)))
    reference = reference if reference in scored else int(scored[0])
    lowest = np.nanmin(sigma_ukcmb2)
    best = tuple(int(number) for number in scored[sigma_ukcmb2[scored] <= lowest * (1 + _EQUAL)])
    shares = np.zeros(len(nothing)) if discarded is None else discarded
    competes[scored] = competing(shares[scored]) & np.isfinite(modes[scored]).all(axis=1)
    # No point is known to be the best alone, or if a point that does not compete is lower.
    if competes.sum() < 2 or not competes[list(best)].any():
        competes[:] = False
    relative = np.linalg.norm(modes, axis=1) if relative is None else relative
    ratio = sigma_ukcmb2 / sigma_ukcmb2[reference]
    apart = np.hypot(relative, relative[reference])
    paired = np.linalg.norm(modes - modes[reference], axis=1)
    apart[reference] = paired[reference] = 0.0
    probability = nothing.copy()
    if competes.any():
        probability[competes] = probability_of_lowest(np.log(sigma_ukcmb2[competes]), modes[competes], rng)
    return Comparison(
        reference=reference,
        best=best,
        competing=competes,
        modes=modes,
        sigma_ukcmb2=sigma_ukcmb2,
        error_ukcmb2=sigma_ukcmb2 * relative,
        ratio=ratio,
        paired_error=ratio * paired,
        independent_error=ratio * apart,
        best_probability=probability,
    )


def probability_of_lowest(log_sigma: np.ndarray, modes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Compute the probability (n,) that each true value is the lowest, from `DRAWS` draws about the measured values.

    Equal values share a draw.
    """
    # As many modes as points are enough: R^T R = modes modes^T.
    factor = np.linalg.qr(modes.T, mode="r")
    won = np.zeros(len(log_sigma))
    for _ in range(DRAWS // _DRAWS_AT_ONCE):
        drawn = log_sigma + rng.standard_normal((_DRAWS_AT_ONCE, len(factor))) @ factor
        lowest = drawn <= drawn.min(axis=1, keepdims=True) + _EQUAL
        won += (lowest / lowest.sum(axis=1, keepdims=True)).sum(axis=0)
    return won / DRAWS
