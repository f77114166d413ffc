"""Progress of a run: a bar on a terminal, plain lines elsewhere, with what can be said so far."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import isnan
from time import monotonic

from surveysim.coadds import CoAdds
from surveysim.scene import Scene
from surveysim.scores import score_survey
from surveysim.setup import prepare, window_observations

STATUS_EVERY_S = 4.0
LINES = 10


Show = Callable[[int, Callable[[], str]], None]  # how many are done; what else there is to say


@contextmanager
def progress_display(name: str, total: int, quiet: bool, what: str = "observations") -> Iterator[Show]:
    """A callable that shows how many of `total` observations (or `what` else) are done, for the time of the block."""
    if quiet:
        yield lambda done, status: None
    elif sys.stderr.isatty():
        with _bar(name, total) as show:
            yield show
    else:
        yield _lines(name, total, what)


@contextmanager
def _bar(name: str, total: int) -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[status]}"),
    )
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(name, total=total, status="")
        said = monotonic()

        def show(done: int, status: Callable[[], str]) -> None:
            nonlocal said
            bar.update(task, completed=done)
            if monotonic() - said > STATUS_EVERY_S:
                bar.update(task, status=status())
                said = monotonic()

        yield show


def _lines(name: str, total: int, what: str) -> Show:
    every = max(1, total // LINES)
    first: list[tuple[float, int]] = []  # when the first was in; before it lie start-up and compilation

    def show(done: int, status: Callable[[], str]) -> None:
        if not first:
            first.append((monotonic(), done))
        if done % every == 0 or done == total:
            since, begun = monotonic() - first[0][0], done - first[0][1]
            left = f", {since / begun * (total - done):.0f} s left" if begun else ""
            print(f"{name}: {done}/{total} {what}{left}  {status()}".rstrip(), file=sys.stderr, flush=True)

    return show


def score_so_far(scene: Scene, coadds: CoAdds) -> str:
    """``sigma(A) = 270 +- 8 uK_CMB^2`` of the actual data so far, plain: quick; empty while it can't be said."""
    windows = window_observations(scene)[: coadds.done].sum()
    if scene.score is None or coadds.done < 2 or windows < 2:
        return ""
    try:
        band = score_survey(prepare(scene), coadds, ("actual",))["actual"].band
    except ValueError:  # too few scans are kept so far
        return ""
    error = "" if isnan(band.error_ukcmb2) else f" +- {band.error_ukcmb2:.2g}"
    return f"plain sigma(A) = {band.sigma_ukcmb2:.3g}{error} uK_CMB^2"
