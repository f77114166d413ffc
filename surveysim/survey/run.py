"""A run: all observations through an engine, with a checkpoint."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

import numpy as np

from surveysim.reduction.noise_weights import weights_file
from surveysim.reduction.observation import observe
from surveysim.reduction.resource_limits import LARGE_SUMS
from surveysim.reduction.setup import Setup, prepare, signal_sim_observations, work_s
from surveysim.runtime.engine import SERIAL, Engine, EngineError, defer_signals, unordered_map
from surveysim.runtime.errors import InputError
from surveysim.scene.scene import Scene
from surveysim.survey.bright_sky import WHAT as BRIGHT_SKY
from surveysim.survey.bright_sky import (
    bright_sky_file,
    load_bright_sky,
    next_sky,
    no_bright_sky,
    restored,
    save_bright_sky,
    with_estimate,
)
from surveysim.survey.checkpoint import (
    check_streams,
    check_weights,
    load_checkpoint,
    save_checkpoint,
    weights_directory,
)
from surveysim.survey.coadd_tree import CoAddTree, node_bytes
from surveysim.survey.coadds import CoAdds, observation_sums
from surveysim.survey.remote_node import SUMS_OF_SPANS, node_of
from surveysim.survey.solution import Solving, solved_coadds
from surveysim.survey.spans import Span, Spans
from surveysim.timestreams.simulation import Angles

CHECKPOINT_SECONDS = 10.0  # between checkpoints
CHECKPOINT_SHARE = 0.05  # largest fraction of the time for checkpoints


@dataclass(frozen=True)
class SpanJob:
    """The task of a worker: simulate and reduce a span of observations, and add them up.

    It holds the scene, which each worker prepares: sending the megabytes of a setup to one worker would delay the start
    of the others. It holds the angles of all observations too for workers of this machine, as ephemerides take longest
    to load.
    """

    scene: Scene
    timestream_dir: Path | None
    angles: Angles | None = None
    weights_dir: Path | None = None
    bright_sky_mk: np.ndarray | None = None

    @cached_property
    def setup(self) -> Setup:
        """The scene made ready, once in each worker."""
        setup = replace(prepare(self.scene), bright_sky_mk=self.bright_sky_mk)
        if self.angles is None:
            return setup
        return replace(setup, observing=replace(setup.observing, known_angles=self.angles))

    def __call__(self, span: Span) -> CoAdds:
        """Simulate, clean, bin and add; write the streams if asked."""
        if span.end == span.first + 1:
            return self._observed(span.first)
        sums = CoAddTree(self.setup, first=span.first)
        for number in range(span.first, span.end):
            sums.add(self._observed(number))
            sums.advance()
        return sums.so_far()

    def _observed(self, observation: int) -> CoAdds:
        with_signal_sims = bool(signal_sim_observations(self.scene)[observation])
        path = None if self.timestream_dir is None else self.timestream_dir / f"{observation:04d}.h5"
        weights = None if self.weights_dir is None else weights_file(self.weights_dir, observation)
        result = observe(self.setup, observation, with_signal_sims, path, weights_path=weights)
        return observation_sums(self.setup.analysis, result)


def finished_sums(setup: Setup, checkpoint: Path, timestream_dir: Path | None = None) -> list[CoAdds]:
    """Read the sums over finished observations from a checkpoint; none without such a file.

    Raises
    ------
    CheckpointError
        For a checkpoint, or time-streams or noise weights of finished observations, of another scene.
    """
    if setup.scene.map.maker == "iterative":
        setup = with_estimate(setup, load_bright_sky(bright_sky_file(checkpoint), setup))
    nodes = load_checkpoint(checkpoint, setup) if checkpoint.exists() else []
    if setup.scene.map.solved:
        check_weights(weights_directory(checkpoint), setup, nodes)
    if timestream_dir is not None:
        check_streams(timestream_dir, setup, nodes)
    return nodes


def run_observations(
    setup: Setup,
    checkpoint: Path | None,
    engine: Engine = SERIAL,
    *,
    nodes: Sequence[CoAdds] = (),
    resume: bool = False,
    keep: bool = False,
    timestream_dir: Path | None = None,
    progress: Callable[[CoAddTree], None] = lambda sums: None,
    stops: Callable[[CoAddTree], bool] | None = None,
    solving: Solving = lambda name, iteration: None,
    meanwhile: Callable[[], None] = lambda: None,
) -> CoAdds:
    """Run the observations of a scene in parallel and add them up; the bits do not depend on the engine.

    Maps that are solved for are solved at the end, from the noise weights in a folder beside the checkpoint, or in a
    temporary one.

    Parameters
    ----------
    checkpoint
        File for the sums. It is written every few seconds, and when the run stops, fails or is interrupted
        (KeyboardInterrupt and errors pass on).
    nodes
        Sums over finished observations (`finished_sums`) to go on from.
    resume
        Whether to go on from the passes of an iterative map-maker whose bright sky is beside the checkpoint.
    keep
        Whether to write the checkpoint of a whole run too, so that later runs add observations.
    timestream_dir
        Directory for the time-streams; None for none.
    progress
        Called after each observation, or after several that a worker has added up.
    stops
        Called before the first observation and after each: whether to end the run.
    solving
        Called before each iteration of the solution.
    meanwhile
        Called once while worker processes of this machine start.

    Raises
    ------
    EngineError
        If the engine fails.
    """
    if setup.scene.map.maker == "iterative":
        if stops is not None:
            raise InputError("map.maker: found 'iterative' with a limit; it runs whole passes over the survey")
        folders = timestream_dir, None
        run = partial(_run_all, engine=engine, folders=folders, progress=progress, stops=None, meanwhile=meanwhile)
        return _run_passes(setup, checkpoint, run, nodes=nodes, resume=resume, solving=solving)
    with _weights_folder(setup, checkpoint, engine) as weights_dir:
        coadds = _run_all(
            setup,
            checkpoint,
            engine=engine,
            nodes=nodes,
            keep=keep or weights_dir is not None,
            folders=(timestream_dir, weights_dir),
            progress=progress,
            stops=stops,
            meanwhile=meanwhile,
        )
        return coadds if weights_dir is None else solved_coadds(setup, coadds, weights_dir, engine, solving)


def _run_passes(
    setup: Setup,
    checkpoint: Path | None,
    run: Callable[..., CoAdds],
    *,
    nodes: Sequence[CoAdds],
    resume: bool,
    solving: Solving,
) -> CoAdds:
    """Run passes over the survey until the bright part of the map converges; the checkpoint is that of the pass."""
    section, sky = setup.scene.map.iteration, no_bright_sky(setup)
    file = None if checkpoint is None else bright_sky_file(checkpoint)
    if file is not None and resume:
        sky = load_bright_sky(file, setup)
    elif file is not None:
        file.unlink(missing_ok=True)
    while True:
        solving(BRIGHT_SKY, sky.passes)
        coadds = run(with_estimate(setup, sky), checkpoint, nodes=nodes, keep=True)
        after = next_sky(setup, sky, coadds)
        if after.change < section.tolerance or after.passes >= section.max_passes:
            return restored(coadds, sky, after, section.tolerance)
        if file is not None:  # before the checkpoint of the old pass goes, which has the hash of its own sky
            save_bright_sky(file, setup, after)
            checkpoint.unlink(missing_ok=True)
        sky, nodes = after, ()


@contextmanager
def _weights_folder(setup: Setup, checkpoint: Path | None, engine: Engine) -> Iterator[Path | None]:
    """Make the folder of the noise weights, one that is removed afterwards without a checkpoint; None for binned maps.

    Raises InputError where workers elsewhere would not reach it.
    """
    if not setup.scene.map.solved:
        yield None
    elif checkpoint is not None:
        folder = weights_directory(checkpoint)
        folder.mkdir(parents=True, exist_ok=True)
        yield folder
    elif engine.scheduler is not None:
        raise InputError(f"map.maker: {setup.scene.map.maker!r} on a cluster needs an output directory; found none")
    else:
        with TemporaryDirectory(prefix="surveysim-") as name:
            yield Path(name)


def _run_all(
    setup: Setup,
    checkpoint: Path | None,
    *,
    engine: Engine,
    nodes: Sequence[CoAdds],
    keep: bool,
    folders: tuple[Path | None, Path | None],
    progress: Callable[[CoAddTree], None],
    stops: Callable[[CoAddTree], bool] | None,
    meanwhile: Callable[[], None] = lambda: None,
) -> CoAdds:
    """Run and add up the observations; `folders` are those of time-streams and noise weights."""
    sums = CoAddTree(setup, nodes)
    while sums.advance():
        pass
    keeper = _CheckpointWriter(checkpoint, setup, sums.finished)
    if stops is None or not stops(sums):
        try:
            _run_missing(
                setup, sums, keeper, engine, folders=folders, progress=progress, stops=stops, meanwhile=meanwhile
            )
        except BaseException:
            if sums.finished > keeper.finished:  # an earlier checkpoint may have sums of a cluster that is gone
                keeper.save(sums)
            raise
    whole = sums.done == setup.scene.observations
    if keep or not whole:
        keeper.save(sums)
    if not whole:
        _drop_files(folders, sums.done, setup.scene.observations)
    return sums.so_far()


def _run_missing(
    setup: Setup,
    sums: CoAddTree,
    keeper: "_CheckpointWriter",
    engine: Engine,
    *,
    folders: tuple[Path | None, Path | None],
    progress: Callable[[CoAddTree], None],
    stops: Callable[[CoAddTree], bool] | None,
    meanwhile: Callable[[], None],
) -> None:
    """Run the observations that the sums do not have, until all are done or the run is to stop."""
    missing = sums.missing()
    # A run that may stop looks at its sums after each observation; so does one without other processes. Workers may
    # still join a cluster.
    alone = engine.kind != "dask" and engine.workers_for(len(missing)) == 1
    single = stops is not None or alone or node_bytes(setup) > LARGE_SUMS
    n_obs = setup.scene.observations
    # On a cluster single observations show first whether its workers can do the work.
    each_s = work_s(setup, n_obs) / n_obs if engine.kind == "processes" else None
    spans = Spans(missing, single=single, each_s=each_s)
    # Workers elsewhere may have another working directory.
    streams, weights = (None if folder is None else folder.absolute() for folder in folders)
    angles = setup.observing.angles if missing and engine.kind == "processes" else None
    job = SpanJob(setup.scene, streams, angles, weights, setup.bright_sky_mk)
    results = unordered_map(job, spans, engine, SUMS_OF_SPANS, meanwhile)
    try:
        for _, result in results:
            node = node_of(result)
            # An observation is in the sums whole or not at all: a checkpoint may be made of them any time.
            with defer_signals():
                sums.add(node)
            spans.measured(node.total_s / node.done)
            while _advance(sums):
                progress(sums)
                if stops is not None and stops(sums):
                    sums.forget_later()
                    return
            keeper.save_if_due(sums)
            if sums.finished == setup.scene.observations:
                sums.bring_here()  # while the cluster is connected
    except BaseException:
        with suppress(EngineError):
            sums.bring_here()
        sums.forget_remote()
        raise
    finally:
        results.close()


def _advance(sums: CoAddTree) -> bool:
    with defer_signals():
        return sums.advance()


class _CheckpointWriter:
    """Writes the sums of a run to its checkpoint, within a small fraction of the time."""

    def __init__(self, path: Path | None, setup: Setup, finished: int) -> None:
        self.path, self.setup, self.finished = path, setup, finished
        self.due = monotonic() + CHECKPOINT_SECONDS

    def save_if_due(self, sums: CoAddTree) -> None:
        """Save some seconds after the last time: a killed run loses no more work than that."""
        if monotonic() >= self.due:
            self.save(sums)

    def save(self, sums: CoAddTree) -> None:
        """Save unless all observations are saved already."""
        if self.path is None or sums.finished == self.finished:
            return
        start = monotonic()
        save_checkpoint(self.path, sums.nodes(), self.setup)
        self.finished, end = sums.finished, monotonic()
        self.due = end + max(CHECKPOINT_SECONDS, (end - start) / CHECKPOINT_SHARE)


def remove_work(checkpoint: Path) -> None:
    """Remove a checkpoint with what maps other than binned ones keep beside it."""
    for path in (checkpoint, bright_sky_file(checkpoint)):
        path.unlink(missing_ok=True)
    folder = weights_directory(checkpoint)
    if folder.is_dir() and not folder.is_symlink():
        for path in folder.glob("*.npz"):
            path.unlink()
        folder.rmdir()


def _drop_files(folders: tuple[Path | None, Path | None], first: int, end: int) -> None:
    """Remove time-streams and noise weights of observations beyond the end of a stopped run."""
    for folder, suffix in zip(folders, (".h5", ".npz"), strict=True):
        for number in range(first, end if folder is not None else first):
            (folder / f"{number:04d}{suffix}").unlink(missing_ok=True)
