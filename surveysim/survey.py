"""Many observations: engine, checkpoint, and the records of a finished survey."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

from surveysim.checkpoint import load_checkpoint, save_checkpoint
from surveysim.coadds import CoAdds, add_observation, empty_coadds
from surveysim.engines import held_back_signals, ordered_map
from surveysim.reduction import ObservationResult, observe
from surveysim.scene import Scene, scene_hash
from surveysim.setup import Setup, prepare, window_observations

CHECKPOINT_SECONDS = 10.0


@dataclass(frozen=True)
class ObservationJob:
    """What a worker does with an observation's number.

    It holds the scene and not its setup, which each worker prepares: while the megabytes of a setup went to
    one worker, no other would start.
    """

    scene: Scene
    timestream_dir: Path | None

    def __call__(self, observation: int) -> ObservationResult:
        """Simulate, clean and bin; write the streams if asked."""
        with_window = bool(window_observations(self.scene)[observation])
        path = None if self.timestream_dir is None else self.timestream_dir / f"{observation:04d}.h5"
        return observe(prepare(self.scene), observation, with_window, path)


def run_observations(
    setup: Setup,
    checkpoint: Path | None,
    workers: int = 1,
    resume: bool = False,
    timestream_dir: Path | None = None,
    progress: Callable[[CoAdds], None] = lambda coadds: None,
    stops: Callable[[CoAdds], bool] = lambda coadds: False,
) -> CoAdds:
    """Run all observations of a scene, or as many as it takes until `stops`, and add them up in order.

    `progress` is called after each; whether it `stops` is asked after each and before the first. With a `checkpoint`
    path, the sums are written there every few seconds, at the end, and when the run is interrupted or fails
    (KeyboardInterrupt and errors pass on); with `resume`, they are taken up from there. Raises CheckpointError for one
    that does not belong to the scene, and WorkerLostError when a worker process is gone.
    """
    identity = scene_hash(setup.scene)
    coadds = empty_coadds(setup)
    if resume and checkpoint is not None and checkpoint.exists():
        coadds = load_checkpoint(checkpoint, identity)
    left = () if stops(coadds) else range(coadds.done, setup.scene.observations)
    results = ordered_map(ObservationJob(setup.scene, timestream_dir), left, workers)
    saved, saved_done = monotonic(), coadds.done
    try:
        for result in results:
            # An observation is in the sums whole or not at all: a checkpoint may be made of them any time.
            with held_back_signals():
                add_observation(setup, coadds, result)
            progress(coadds)
            if checkpoint is not None and monotonic() - saved > CHECKPOINT_SECONDS:
                save_checkpoint(checkpoint, coadds, identity)
                saved, saved_done = monotonic(), coadds.done
            if stops(coadds):
                break
        if checkpoint is not None and coadds.done > saved_done:
            save_checkpoint(checkpoint, coadds, identity)  # until the results are written
            saved_done = coadds.done
    except BaseException:
        if checkpoint is not None and coadds.done > saved_done:
            save_checkpoint(checkpoint, coadds, identity)
        raise
    finally:
        results.close()
    if timestream_dir is not None and coadds.done < setup.scene.observations:
        _drop_streams(timestream_dir, coadds.done)
    return coadds


def _drop_streams(directory: Path, done: int) -> None:
    """Remove streams that workers wrote ahead of where a run was stopped."""
    for path in (*directory.glob("*.h5"), *directory.glob("*.h5.part")):
        number = path.name.partition(".")[0]
        if number.isdigit() and int(number) >= done:
            path.unlink(missing_ok=True)
