"""Progress of a run: a bar on a terminal, plain lines elsewhere, with the score so far."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from surveysim.coadds import CoAdds
from surveysim.scene import Scene
from surveysim.scores import score_survey
from surveysim.setup import prepare, window_observations

SCORE_EVERY_S = 4.0
LINES = 10


@contextmanager
def progress_display(scene: Scene, quiet: bool) -> Iterator[Callable[[CoAdds], None]]:
    """A callable that shows the sums after each observation, for the time of the block."""
    if quiet:
        yield lambda coadds: None
    elif sys.stderr.isatty():
        with _bar(scene) as show:
            yield show
    else:
        yield _lines(scene)


@contextmanager
def _bar(scene: Scene) -> Iterator[Callable[[CoAdds], None]]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[score]}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(scene.name, total=scene.observations, score="")
        scored = monotonic()

        def show(coadds: CoAdds) -> None:
            nonlocal scored
            bar.update(task, completed=coadds.done)
            if monotonic() - scored > SCORE_EVERY_S:
                bar.update(task, score=score_so_far(scene, coadds))
                scored = monotonic()

        yield show


def _lines(scene: Scene) -> Callable[[CoAdds], None]:
    every = max(1, scene.observations // LINES)
    first: list[tuple[float, int]] = []  # when the first observation was in; before it lie start-up and compilation

    def show(coadds: CoAdds) -> None:
        if not first:
            first.append((monotonic(), coadds.done))
        if coadds.done % every == 0 or coadds.done == scene.observations:
            since, begun = monotonic() - first[0][0], coadds.done - first[0][1]
            left = f", {since / begun * (scene.observations - coadds.done):.0f} s left" if begun else ""
            done = f"{scene.name}: {coadds.done}/{scene.observations} observations{left}"
            print(f"{done}  {score_so_far(scene, coadds)}".rstrip(), file=sys.stderr, flush=True)

    return show


def score_so_far(scene: Scene, coadds: CoAdds) -> str:
    """``sigma(A) = 270 +- 8 uK_CMB^2`` of the actual data so far; empty while it can't be said."""
    windows = window_observations(scene)[: coadds.done].sum()
    if scene.score is None or coadds.done < 2 or windows < 2:
        return ""
    try:
        band = score_survey(prepare(scene), coadds, ("actual",))["actual"].band
    except ValueError:  # too few scans are kept so far
        return ""
    return f"sigma(A) = {band.sigma_ukcmb2:.3g} +- {band.error_ukcmb2:.2g} uK_CMB^2"
