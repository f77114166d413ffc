"""The Python interface of cameras of several bands: each band is a survey of its own, one after another."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from time import perf_counter

from surveysim.api.forecasts import forecast_survey
from surveysim.api.surveys import PROCESSES, finished_survey, run_survey
from surveysim.output.band_writer import write_band_forecasts, write_bands
from surveysim.output.directory import FinishedError, begin, claimed, remove_nested, replacing
from surveysim.output.expected_files import band_directory, of_bands, of_run
from surveysim.reduction.setup import Setup, prepare
from surveysim.results.bands import MultiBandForecast, MultiBandResult
from surveysim.results.results import SurveyResult
from surveysim.results.stopping import StoppingCriteria, check_limits
from surveysim.runtime.engine import Engine
from surveysim.runtime.errors import InputError, NotForecastableError, SceneError
from surveysim.scene.bands import MultiBandScene, load_bands, of_each_band
from surveysim.scene.kinds import is_sweep
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.scene.scene import Scene
from surveysim.scene.shipped import find_scene
from surveysim.survey.coadd_tree import CoAddTree

Progress = Callable[[CoAddTree], None]
SHORTEST_S = 1e-3  # time budget of a band where none is left: its first observations


def run_bands(
    scenes: MultiBandScene | str | Path,
    out: str | Path | None = None,
    *,
    engine: Engine = PROCESSES,
    resume: bool = False,
    save_timestreams: bool = False,
    figures: bool = True,
    progress: Progress = lambda sums: None,
    display: Callable[[Setup], AbstractContextManager[Progress]] | None = None,
    target_error: float | None = None,
    target_metric: str = SIGMA_KEY,
    time_budget_s: float | None = None,
    force: bool = False,
) -> MultiBandResult:
    """Run all bands of a camera; parameters and errors are those of `surveysim.run`.

    `display` makes the `progress` of one band, for the time of its run.
    """
    start, scenes = perf_counter(), checked_bands(scenes)
    limits = StoppingCriteria(target_error, time_budget_s, target_metric)
    of_each_band(scenes.path, scenes.content, lambda name: check_limits(prepare(scenes.bands[name]), limits))
    if save_timestreams and out is None:
        raise InputError("save_timestreams: found no output directory; one is expected")

    def result_of(directory: Path | None) -> MultiBandResult:
        found: dict[str, SurveyResult] = {}
        for name, scene in scenes.bands.items():
            left = len(scenes.bands) - len(found)
            budget = time_budget_s and max(SHORTEST_S, (time_budget_s - (perf_counter() - start)) / left)
            with display(prepare(scene)) if display else nullcontext(progress) as shown:
                found[name] = _run_band(
                    scene,
                    directory and directory / band_directory(name),
                    engine=engine,
                    resume=resume,
                    save_timestreams=save_timestreams,
                    figures=figures,
                    progress=shown,
                    limits=StoppingCriteria(target_error, budget, target_metric),
                    force=force,
                )
            for layer in found[name].setup.air.layers:
                layer.strips.forget()  # those of one band at a time
        return MultiBandResult(scenes, found, perf_counter() - start, engine.kind)

    if out is None:
        return result_of(None)
    with claimed(Path(out), of_bands(scenes, "run"), force, resume) as place:
        for name, scene in scenes.bands.items() if not resume else ():
            expected = of_run(prepare(scene), figures, save_timestreams)
            with claimed(place.path / band_directory(name), expected, force):  # or an error, before any work
                pass
        begin(place, removed=lambda name: force)
        if force:
            remove_nested(place.path, scenes.bands)
        result = result_of(place.path)
        with replacing(place, whole=result.is_whole) as new:
            write_bands(new, result)
    return result


def _run_band(
    scene: Scene,
    out: Path | None,
    *,
    engine: Engine,
    resume: bool,
    save_timestreams: bool,
    figures: bool,
    progress: Progress,
    limits: StoppingCriteria,
    force: bool,
) -> SurveyResult:
    try:
        return run_survey(
            scene,
            out,
            engine=engine,
            resume=resume,
            save_timestreams=save_timestreams,
            figures=figures,
            progress=progress,
            target_error=limits.target_error,
            target_metric=limits.metric,
            time_budget_s=limits.time_budget_s,
            force=force,
        )
    except FinishedError:  # in the run that is resumed
        return finished_survey(scene, out)


def forecast_bands(
    scenes: MultiBandScene | str | Path, out: str | Path | None = None, *, force: bool = False
) -> MultiBandForecast:
    """Forecast the scores of all bands of a camera; parameters and errors are those of `surveysim.forecast`."""
    scenes = checked_bands(scenes)

    def result_of(directory: Path | None) -> MultiBandForecast:
        found, reasons = {}, {}
        for name, scene in scenes.bands.items():
            try:
                found[name] = forecast_survey(scene, directory and directory / band_directory(name), force=force)
            except NotForecastableError as error:
                reasons[name] = str(error)
        if not found:
            raise NotForecastableError("; ".join(f"bands.{name}: {reason}" for name, reason in reasons.items()))
        return MultiBandForecast(scenes, found, reasons)

    if out is None:
        return result_of(None)
    with claimed(Path(out), of_bands(scenes, "forecast"), force) as place:
        result = result_of(place.path)
        with replacing(place) as new:
            write_band_forecasts(new, result)
    return result


def checked_bands(scenes: MultiBandScene | str | Path) -> MultiBandScene:
    """Load the scenes of all bands where they are not given, and make each ready once; errors name their bands."""
    if not isinstance(scenes, MultiBandScene):
        if is_sweep(scenes):
            raise SceneError(f"{find_scene(scenes)}: sweep: found a sweep; a scene without [sweep] is expected")
        scenes = load_bands(scenes)
    bands = scenes.bands
    of_each_band(scenes.path, scenes.content, lambda name: prepare(bands[name]))
    return scenes
