"""Running a point of a sweep in one process: to a number of its observations, with a checkpoint."""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from time import perf_counter

from surveysim.forecasting.forecast import Forecast
from surveysim.reduction.cleaning_pipelines import ACTUAL
from surveysim.reduction.setup import Setup, prepare
from surveysim.results.agreement import agreement
from surveysim.results.results import SurveyResult, quoted_forecast, survey_result
from surveysim.results.stopping import UNLIMITED, StoppingCriteria
from surveysim.runtime.errors import InputError
from surveysim.scene.scene import scene_hash
from surveysim.studies.sweep.axes import Point
from surveysim.studies.sweep.point_store import PointResult, point_checkpoint, point_file, save_point
from surveysim.survey.checkpoint import CheckpointError
from surveysim.survey.coadds import CoAdds
from surveysim.survey.run import finished_sums, remove_work, run_observations

Keep = Callable[[Point, SurveyResult], None]  # writes the results of a point


@dataclass(frozen=True, eq=False)
class Stage:
    """A point, and the number of its first observations to run."""

    point: Point
    observations: int

    @property
    def is_whole(self) -> bool:
        """True if all observations of the point run."""
        return self.observations == self.point.scene.observations

    @property
    def file(self) -> str:
        """Name of its file in the folder of finished points."""
        return point_file(self.point.number, self.observations, self.point.scene.observations)


def whole(point: Point) -> Stage:
    """Return the stage with all observations of a point."""
    return Stage(point, point.scene.observations)


@dataclass(frozen=True)
class PointJob:
    """Run, score and forecast a point in one process.

    Parameters
    ----------
    directory
        Directory for its file and its checkpoint; None for none.
    resume
        Continue from the checkpoint.
    keep
        Function that writes its results; None for none.
    """

    directory: Path | None
    resume: bool
    keep: Keep | None = None

    def __call__(self, stage: Stage) -> PointResult:
        """Run a point; raises an error that names the point, and CheckpointError for a checkpoint of another scene."""
        start, setup = perf_counter(), prepare(stage.point.scene)
        checkpoint = self.directory and point_checkpoint(self.directory, stage.point.number)
        try:
            coadds = self._run(setup, stage, checkpoint)
        except CheckpointError:
            raise
        except InputError as error:
            raise InputError(f"point ({stage.point.label}): {error}") from None
        limits = UNLIMITED if stage.is_whole else StoppingCriteria(in_rounds=True)
        result = survey_result(setup, coadds, wall_s=perf_counter() - start, workers=1, limits=limits)
        if self.keep is not None:
            self.keep(stage.point, result)
        found = point_result(result)
        if self.directory is not None:
            save_point(self.directory / stage.file, found, scene_hash(stage.point.scene))
            if stage.is_whole:
                remove_work(checkpoint)
        return found

    def _run(self, setup: Setup, stage: Stage, checkpoint: Path | None) -> CoAdds:
        nodes = finished_sums(setup, checkpoint) if self.resume and checkpoint is not None else []
        if stage.is_whole:
            return run_observations(setup, checkpoint, nodes=nodes, resume=self.resume)
        return run_observations(setup, checkpoint, nodes=nodes, stops=lambda sums: sums.done >= stage.observations)


def point_result(result: SurveyResult) -> PointResult:
    """Return the part of a run's result that comparisons with other runs need."""
    setup, lost = result.setup, result.discards
    sigma, off = {}, []
    if result.expected is not None:
        forecasts = result.expected.scores
        sigma = {name: quoted_forecast(result.scores[name], item) for name, item in forecasts.items()}
        found = agreement(setup, result.scores[ACTUAL], forecasts[ACTUAL])
        off = [found.sigma, found.sigma_error]
    return PointResult(
        setup.camera.n_det,
        result.coadds.done,
        result.scores,
        sigma,
        off,
        forecast_flags(result.expected),
        lost.shares,
        lost.by_weather,
        _skies(setup),
        result.unscored,
        result.wall_s,
        result.metrics,
        {},
    )


def forecast_flags(found: Forecast | None) -> list[str]:
    """Reasons why the forecast of the actual data may be off."""
    return [effect.sentence for effect in found.scores[ACTUAL].effects if effect.flagged] if found else []


def _skies(setup: Setup) -> str:
    """Return a key that is equal for points whose signal simulations are the same: same seed, skies and grid."""
    scene = setup.scene
    return sha256(f"{scene.seed} {scene.score.signal_sims} {setup.sky.geometry}".encode()).hexdigest()
