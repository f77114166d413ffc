"""The Python interface of surveys: simulate, run, forecast and plan a scene."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from time import perf_counter

from threadpoolctl import threadpool_limits

from mapmaker.timestreams import Timestreams
from surveysim.output.directory import begin, claimed, remove_nested, replacing
from surveysim.output.expected_files import of_run
from surveysim.output.writer import write_outputs
from surveysim.reduction.setup import Setup, is_quick, prepare
from surveysim.results.results import SurveyResult, survey_result
from surveysim.results.stopping import StoppingCriteria, check_limits, stopping_rule
from surveysim.runtime.engine import SERIAL, Engine, defer_signals
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.kinds import is_sweep
from surveysim.scene.metrics import SIGMA_KEY
from surveysim.scene.scene import Scene, load_scene
from surveysim.scene.shipped import find_scene
from surveysim.survey.bright_sky import FILE as BRIGHT_SKY
from surveysim.survey.checkpoint import NAME as CHECKPOINT
from surveysim.survey.checkpoint import WEIGHTS
from surveysim.survey.coadd_tree import CoAddTree
from surveysim.survey.coadds import CoAdds
from surveysim.survey.run import finished_sums, run_observations
from surveysim.survey.solution import Solving
from surveysim.timestreams.observation import draw_observation

PROCESSES = Engine()


def simulate_observation(scene: Scene | str | Path, observation: int) -> Timestreams:
    """Simulate the time-streams of one observation.

    Parameters
    ----------
    scene
        A scene, the path of its file, or its name.
    observation
        Number of the observation, from 0.

    Returns
    -------
    Time-streams of all detectors, whole whatever `numerics.max_block_memory` is. Their attributes hold the weather
    that was drawn.

    Raises
    ------
    SceneError
        The scene can't be run.
    InputError
        The scene does not have this observation.
    """
    scene = scene_as_given(scene)
    if not 0 <= observation < scene.observations:
        raise InputError(f"observation: found {observation}; 0 to {scene.observations - 1} is expected")
    with threadpool_limits(1):  # the same bits as in a run
        return draw_observation(prepare(scene), observation)


def run_survey(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    engine: Engine = PROCESSES,
    resume: bool = False,
    save_timestreams: bool = False,
    figures: bool = True,
    progress: Callable[[CoAddTree], None] = lambda sums: None,
    target_error: float | None = None,
    target_metric: str = SIGMA_KEY,
    time_budget_s: float | None = None,
    force: bool = False,
    solving: Solving = lambda name, iteration: None,
) -> SurveyResult:
    """Simulate, clean, map and score a scene of one band; parameters and errors are those of `surveysim.run`.

    `solving` is called before each iteration of a map that is solved for, with what it is and the iteration's number.
    """
    start, limits = perf_counter(), StoppingCriteria(target_error, time_budget_s, target_metric)
    setup = prepare(scene_as_given(scene))
    check_limits(setup, limits)
    engine = engine.for_work(is_quick(setup, target_error))
    workers = engine.workers_for(setup.scene.observations)
    if save_timestreams and out is None:
        raise InputError("save_timestreams: found no output directory; one is expected")

    def result_of(checkpoint: Path | None, streams: Path | None, nodes: Sequence[CoAdds] = ()) -> SurveyResult:
        stops = stopping_rule(setup, limits, start)
        coadds = run_observations(
            setup,
            checkpoint,
            engine,
            nodes=nodes,
            resume=resume,
            keep=True,
            timestream_dir=streams,
            progress=progress,
            stops=stops,
            solving=solving,
            meanwhile=lambda: _ready_for_the_end(setup, figures and out is not None),
        )
        return survey_result(
            setup, coadds, wall_s=perf_counter() - start, workers=workers, limits=limits, engine=engine.kind
        )

    if out is None:
        return result_of(None, None)
    with claimed(Path(out), of_run(setup, figures, save_timestreams), force, resume) as place:
        checkpoint, streams = place.path / CHECKPOINT, place.path / "timestreams" if save_timestreams else None
        nodes = finished_sums(setup, checkpoint, streams) if resume else []  # or an error, before anything is changed
        begin(place, removed=lambda name: force)
        if force:
            remove_nested(place.path)
        result = result_of(checkpoint, streams, nodes)
        whole = result.coadds.done == setup.scene.observations
        with replacing(place, whole=whole) as new:
            numbers = range(result.coadds.done)
            names = [f"timestreams/{number:04d}.h5" for number in numbers if save_timestreams]
            names += [f"{WEIGHTS}/{number:04d}.npz" for number in numbers if setup.scene.map.solved]
            names += [BRIGHT_SKY] if setup.scene.map.maker == "iterative" else []
            # None of before a resumption that asked for them.
            write_outputs(new, result, figures, [name for name in names if (place.path / name).is_file()])
    return result


def _ready_for_the_end(setup: Setup, figures: bool) -> None:
    """Do what the end of a run needs: expectations of the scores, and the library for figures."""
    if setup.scene.score is not None:
        from surveysim.results.control_variate import known_expectations

        known_expectations(setup)
    if figures:
        with defer_signals(), suppress(Exception):  # each figure that can't be drawn is reported at the end
            import_module("surveysim.report.figures.survey")


def finished_survey(scene: Scene, out: Path) -> SurveyResult:
    """Score the finished run of a scene in `out` again, from its checkpoint; CheckpointError if that is another's."""
    start, setup, checkpoint = perf_counter(), prepare(scene), out / CHECKPOINT
    nodes = finished_sums(setup, checkpoint)
    beside = scene.map.maker != "binned"  # the maps need more than the checkpoint
    coadds = run_observations(setup, checkpoint if beside else None, SERIAL, nodes=nodes, resume=beside)
    return survey_result(setup, coadds, wall_s=perf_counter() - start, workers=1)


def scene_as_given(scene: Scene | str | Path) -> Scene:
    """Return a scene as it is given, or load it; raises SceneError for a file with a table [sweep]."""
    if isinstance(scene, Scene):
        return scene
    if is_sweep(scene):
        raise SceneError(f"{find_scene(scene)}: sweep: found a sweep; a scene without [sweep] is expected")
    return load_scene(scene)
