"""A run: all observations through an engine, with a checkpoint."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from surveysim.reduction.observation import ObservationResult, observe
from surveysim.reduction.setup import Setup, prepare, signal_sim_observations
from surveysim.runtime.engine import SERIAL, Engine, defer_signals, ordered_map
from surveysim.scene.scene import Scene, scene_hash
from surveysim.survey.checkpoint import check_streams, load_checkpoint, save_checkpoint
from surveysim.survey.coadds import CoAdds, add_observation, empty_coadds

CHECKPOINT_SECONDS = 10.0  # between checkpoints
CHECKPOINT_SHARE = 0.05  # largest fraction of the time for checkpoints


@dataclass(frozen=True)
class ObservationJob:
    """The task of a worker: simulate and reduce the observation with a number.

    It holds the scene, which each worker prepares: sending the megabytes of a setup to one worker would delay the start
    of the others.
    """

    scene: Scene
    timestream_dir: Path | None

    def __call__(self, observation: int) -> ObservationResult:
        """Simulate, clean and bin; write the streams if asked."""
        with_signal_sims = bool(signal_sim_observations(self.scene)[observation])
        path = None if self.timestream_dir is None else self.timestream_dir / f"{observation:04d}.h5"
        return observe(prepare(self.scene), observation, with_signal_sims, path)


def run_observations(
    setup: Setup,
    checkpoint: Path | None,
    engine: Engine = SERIAL,
    *,
    resume: bool = False,
    timestream_dir: Path | None = None,
    progress: Callable[[CoAdds], None] = lambda coadds: None,
    stops: Callable[[CoAdds], bool] = lambda coadds: False,
) -> CoAdds:
    """Run the observations of a scene in parallel and add them up in order.

    Parameters
    ----------
    checkpoint
        File for the sums. It is written every few seconds, and when the run stops, fails or is interrupted
        (KeyboardInterrupt and errors pass on).
    resume
        Whether to start from the checkpoint.
    timestream_dir
        Directory for the time-streams; None for none.
    progress
        Called after each observation.
    stops
        Called before the first observation and after each: whether to end the run.

    Raises
    ------
    CheckpointError
        For a checkpoint of another scene.
    EngineError
        If the engine fails.
    """
    identity = scene_hash(setup.scene)
    coadds = empty_coadds(setup.analysis)
    if resume and checkpoint is not None and checkpoint.exists():
        coadds = load_checkpoint(checkpoint, setup)
        if timestream_dir is not None:
            check_streams(timestream_dir, setup, coadds.done)
    keeper = _CheckpointWriter(checkpoint, identity, coadds.done)
    left = () if stops(coadds) else range(coadds.done, setup.scene.observations)
    # Workers elsewhere may have another working directory.
    streams = None if timestream_dir is None else timestream_dir.absolute()
    results = ordered_map(ObservationJob(setup.scene, streams), left, engine)
    try:
        for result in results:
            # Observations are added whole, so a checkpoint can be made at any time.
            with defer_signals():
                add_observation(setup.analysis, coadds, result)
            progress(coadds)
            keeper.save_if_due(coadds)
            if stops(coadds):
                break
    except BaseException:
        keeper.save(coadds)
        raise
    finally:
        results.close()
    if coadds.done < setup.scene.observations:
        keeper.save(coadds)
        if timestream_dir is not None:
            _drop_streams(timestream_dir, coadds.done, setup.scene.observations)
    return coadds


class _CheckpointWriter:
    """Writes the sums of a run to its checkpoint, within a small fraction of the time."""

    def __init__(self, path: Path | None, scene_hash: str, done: int) -> None:
        self.path, self.scene_hash, self.done = path, scene_hash, done
        self.due = monotonic() + CHECKPOINT_SECONDS

    def save_if_due(self, coadds: CoAdds) -> None:
        """Save some seconds after the last time: a killed run loses no more work than that."""
        if monotonic() >= self.due:
            self.save(coadds)

    def save(self, coadds: CoAdds) -> None:
        """Save unless all observations are saved already."""
        if self.path is None or coadds.done == self.done:
            return
        start = monotonic()
        save_checkpoint(self.path, coadds, self.scene_hash)
        self.done, end = coadds.done, monotonic()
        self.due = end + max(CHECKPOINT_SECONDS, (end - start) / CHECKPOINT_SHARE)


def _drop_streams(directory: Path, first: int, end: int) -> None:
    """Remove streams of observations beyond the end of a stopped run."""
    for number in range(first, end):
        (directory / f"{number:04d}.h5").unlink(missing_ok=True)
