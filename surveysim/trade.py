"""The points of a sweep run, and set against each other: ratios with paired errors, and which point is the best."""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from time import perf_counter

import numpy as np

from surveysim.checkpoint import CheckpointError
from surveysim.coadds import CoAdds
from surveysim.control import quoted_scores
from surveysim.engines import Engine, ordered_map
from surveysim.point_files import PointResult, finished_points, load_point, point_checkpoint, point_file, save_point
from surveysim.recipes import ACTUAL
from surveysim.scene import scene_hash
from surveysim.scores import DataSetScore, error_modes
from surveysim.setup import Setup, prepare
from surveysim.survey import run_observations
from surveysim.sweep import Point, Sweep

DRAWS = 20_000  # of the best point: a probability of 0.5 is known to 0.004
_DRAWS_AT_ONCE = 1000
SURE = 0.995  # from here on a probability rounds to 100 %, which it is not
_EQUAL = 1e-9  # relative difference below which two points are equal


@dataclass(frozen=True)
class Comparison:
    """Points against each other, (n_point,) each and NaN for a point without a score.

    `ratio` is sigma(A) over that of the point `reference`, `paired_error` its error and `independent_error` what it
    would be if the two shared nothing; `best_probability` that of being the lowest. `best` are the lowest points:
    several if they are equal, none where nothing is scored.
    """

    reference: int | None
    best: tuple[int, ...]
    sigma_ukcmb2: np.ndarray
    error_ukcmb2: np.ndarray
    ratio: np.ndarray
    paired_error: np.ndarray
    independent_error: np.ndarray
    best_probability: np.ndarray


@dataclass(frozen=True)
class SweepResult:
    """A finished sweep; `simulated` is false where its points are forecasts alone."""

    sweep: Sweep
    points: tuple[PointResult, ...]
    comparison: Comparison
    simulated: bool
    wall_s: float
    workers: int
    engine: str


@dataclass(frozen=True)
class PointJob:
    """Run, score and forecast a point in one process, and keep it in `directory` if there is one."""

    directory: Path | None
    resume: bool

    def __call__(self, point: Point) -> PointResult:
        """Raises ValueError that names the point, and CheckpointError for a checkpoint of another scene."""
        start, setup, checkpoint = perf_counter(), prepare(point.scene), None
        if self.directory is not None:
            checkpoint = point_checkpoint(self.directory, point.number)
        try:
            coadds = run_observations(setup, checkpoint, resume=self.resume)
        except CheckpointError:
            raise
        except (ValueError, ArithmeticError) as error:
            raise ValueError(f"point ({point.label}): {error}") from None
        scores, unscored = _scored(setup, coadds)
        forecast, _ = forecast_sigma(point)
        result = PointResult(setup.n_det, scores, forecast, _skies(setup), unscored, perf_counter() - start)
        if self.directory is not None:
            save_point(point_file(self.directory, point.number), result, scene_hash(point.scene))
            checkpoint.unlink(missing_ok=True)
        return result


def _scored(setup: Setup, coadds: CoAdds) -> tuple[dict[str, DataSetScore], str]:
    """Scores by data set, or none and why."""
    try:
        return quoted_scores(setup, coadds), ""
    except ValueError as error:  # too few observations, or too few scans kept in them
        return {}, str(error)


def run_points(
    sweep: Sweep,
    directory: Path | None,
    engine: Engine,
    resume: bool,
    progress: Callable[[int], None],
) -> tuple[PointResult, ...]:
    """Run all points, several at a time, each by one worker; `progress` is told how many are done.

    Points are kept in `directory`, finished or not, and taken up from there with `resume`. Raises CheckpointError
    for files of other scenes, EngineError when the engine can't go on, ValueError when a point fails.
    """
    found = _kept(sweep, directory) if resume and directory is not None else {}
    missing = [point for point in sweep.points if point.number not in found]
    # Workers elsewhere may have another working directory.
    kept = None if directory is None else directory.absolute()
    results = ordered_map(PointJob(kept, resume), missing, engine)
    try:
        for point in missing:
            found[point.number] = next(results)
            progress(len(found))
    finally:
        results.close()
    return tuple(found[point.number] for point in sweep.points)


def _kept(sweep: Sweep, directory: Path) -> dict[int, PointResult]:
    """Finished points by number; raises CheckpointError for files that are not of this sweep."""
    found = {}
    for number, path in finished_points(directory).items():
        if number >= len(sweep.points):
            raise CheckpointError(
                f"{path}: of another sweep (this one has {len(sweep.points)} points); "
                "run without --resume, or with --out elsewhere"
            )
        found[number] = load_point(path, scene_hash(sweep.points[number].scene))
    return found


def forecast_sigma(point: Point) -> tuple[dict[str, float], str]:
    """Forecasts of sigma(A) [uK_CMB^2] by data set, or none and why."""
    from surveysim.forecast import forecast

    try:
        scores = forecast(point.scene).scores
    except ValueError as error:  # of a scene that can't be forecast
        return {}, str(error)
    return {name: float(item.band.sigma_ukcmb2) for name, item in scores.items()}, ""


def forecast_points(sweep: Sweep, progress: Callable[[int], None]) -> tuple[PointResult, ...]:
    """Forecasts of all points, one after the other."""
    results = []
    for point in sweep.points:
        start = perf_counter()
        sigma, reason = forecast_sigma(point)
        results.append(PointResult(point.n_det, {}, sigma, "", reason, perf_counter() - start))
        progress(len(results))
    return tuple(results)


def _skies(setup: Setup) -> str:
    """Equal where the windows' errors are: the same skies through the same detectors, scans and cleaning."""
    scene, plane = setup.scene, setup.camera.focal_plane
    passed = (scene.score.window, scene.observations, scene.scan, scene.cleaning, setup.sky_geometry)
    places = np.round([plane.x_rad, plane.y_rad], 8) + 0.0  # 2 milliarcsec; no negative zeros
    text = f"{passed} {places.tobytes().hex()}"
    return sha256(text.encode()).hexdigest()


# ---------------------------------------------------------------- comparison


def compare_runs(points: tuple[PointResult, ...], rng: np.random.Generator) -> Comparison:
    """Runs of the actual data set against each other, with what their errors share."""
    scored = {number: point.scores[ACTUAL] for number, point in enumerate(points) if point.scores}
    sigma = np.full(len(points), np.nan)
    modes = np.zeros((len(points), 1))
    if scored:
        numbers = list(scored)
        sigma[numbers] = [item.band.sigma_ukcmb2 for item in scored.values()]
        found = error_modes(list(scored.values()), [points[number].skies for number in numbers])
        modes = np.zeros((len(points), found.shape[1]))
        modes[numbers] = found
    return compare(sigma, modes, rng)


def compare_forecasts(points: tuple[PointResult, ...]) -> Comparison:
    """Forecasts of the actual data set against each other, which have no Monte Carlo errors."""
    sigma = np.array([point.forecast_ukcmb2.get(ACTUAL, np.nan) for point in points])
    return compare(sigma, np.zeros((len(points), 1)), np.random.default_rng(0))


def compare(sigma_ukcmb2: np.ndarray, modes: np.ndarray, rng: np.random.Generator) -> Comparison:
    """Compare points (n_point,), NaN for none, whose ln sigma respond to unit deviates as `modes` (n_point, n_mode).

    The first point with a score is the reference.
    """
    scored = np.flatnonzero(np.isfinite(sigma_ukcmb2))
    nothing = np.full(len(sigma_ukcmb2), np.nan)
    if len(scored) == 0:
        return Comparison(None, (), *(nothing.copy() for _ in range(6)))
    reference = int(scored[0])
    relative = np.linalg.norm(modes, axis=1)
    ratio = sigma_ukcmb2 / sigma_ukcmb2[reference]
    apart = np.hypot(relative, relative[reference])
    apart[reference] = 0.0
    probability = nothing.copy()
    probability[scored] = probability_of_lowest(np.log(sigma_ukcmb2[scored]), modes[scored], rng)
    lowest = np.nanmin(sigma_ukcmb2)
    return Comparison(
        reference=reference,
        best=tuple(int(number) for number in scored[sigma_ukcmb2[scored] <= lowest * (1 + _EQUAL)]),
        sigma_ukcmb2=sigma_ukcmb2,
        error_ukcmb2=sigma_ukcmb2 * relative,
        ratio=ratio,
        paired_error=ratio * np.linalg.norm(modes - modes[reference], axis=1),
        independent_error=ratio * apart,
        best_probability=probability,
    )


def probability_of_lowest(log_sigma: np.ndarray, modes: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Probability (n,) that each of the true values is the lowest, by `DRAWS` draws about those found.

    Values that are equal share a draw.
    """
    # As many modes as points are enough: R^T R = modes modes^T.
    factor = np.linalg.qr(modes.T, mode="r")
    won = np.zeros(len(log_sigma))
    for _ in range(DRAWS // _DRAWS_AT_ONCE):
        drawn = log_sigma + rng.standard_normal((_DRAWS_AT_ONCE, len(factor))) @ factor
        lowest = drawn <= drawn.min(axis=1, keepdims=True) + _EQUAL
        won += (lowest / lowest.sum(axis=1, keepdims=True)).sum(axis=0)
    return won / DRAWS
