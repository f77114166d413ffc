"""Progress of a run: a bar on a terminal, plain lines elsewhere, with the score so far."""

import heapq
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import monotonic
from typing import TYPE_CHECKING, Protocol

import numpy as np

from mapmaker.printable import complain
from surveysim.cli.interrupts import stopping
from surveysim.reduction.setup import Setup, signal_sim_observations
from surveysim.runtime.numbers import plain, quoted
from surveysim.scene.scene import Scene
from surveysim.survey.coadd_tree import CoAddTree

if TYPE_CHECKING:
    from surveysim.report.terminal.layout import Terminal

STATUS_EVERY_S = 4.0
LINES = 10
SOLVED_EVERY = 5  # iterations between lines
STATUS_COLUMNS = 54  # width of the texts next to the bar
SHORTEST_BAR = 4


START_S = 10.0  # longest time of a process to start and compile
LEAST = 0.01  # smallest time left over the time so far: running items may take longer than others
SIGNAL_SIM_WORK = 2.5  # work of an observation with signal simulations, over one without: measured with lynx
ENOUGH = 0.5  # work after the first item, over its work, that is enough to estimate the time left


class Show(Protocol):
    """Display of the number of finished items, a status, and the time left."""

    def __call__(self, done: int, status: Callable[[], str], left_s: float | None = None) -> None:
        """Show the progress; `left_s` is the time left [s] if the items tell it."""


def equal_work(n: int) -> np.ndarray:
    """Work of n items that take equally long."""
    return np.ones(n)


class TimeLeft:
    """Estimate of the time left, from the times at which items finish and the work (n,) of each.

    `workers` take the items in turn, and results come in order. The time per work is measured from the first finished
    item on, because start-up and compilation come before it. Until enough work is done, it is the time since the
    start, unless start-up may dominate it.
    """

    def __init__(
        self, work: Sequence[float] | np.ndarray, workers: int, clock: Callable[[], float] = monotonic
    ) -> None:
        self.work, self.workers, self.clock = np.asarray(work, float), workers, clock
        self.start = clock()
        self.first: tuple[float, int] | None = None
        self.times = np.zeros(0)
        self.end: float | None = None

    def add(self, done: int, left_s: float | None = None) -> float | None:
        """Return the seconds left now that `done` items are finished, `left_s` if given; None if unknown."""
        left = self._from_arrivals(done) if left_s is None else left_s
        now = self.clock()
        known = left > LEAST * (now - self.start)
        self.end = now + left if known else None
        return left if known else None

    def _from_arrivals(self, done: int) -> float:
        """Estimate the seconds left from the times at which items came; 0 if unknown."""
        now = self.clock()
        if self.first is None:  # those before it were kept from an earlier run
            self.first = now, done
            self.times = finish_times(self.work[max(0, done - 1) :], self.workers)
        (since, first), times = self.first, self.times
        whole, so_far = times[-1], times[min(done - first, len(times) - 1)]
        if so_far >= (1 + ENOUGH) * times[0]:
            return (now - since) * (whole - so_far) / (so_far - times[0])
        return (now - self.start) * (whole - so_far) / so_far if now - self.start > START_S else 0.0

    def now(self) -> float | None:
        """Return the seconds left by the last estimate; None without one, or when it was too short."""
        left = None if self.end is None else self.end - self.clock()
        return left if left is not None and left > 0 else None


def finish_times(work: np.ndarray, workers: int) -> np.ndarray:
    """Compute when each item (n,) and all before it are finished, in units of work; free workers take the next item."""
    free, times = [0.0] * workers, []
    for item in work:
        times.append(heapq.heapreplace(free, free[0] + float(item)) + float(item))
    return np.maximum.accumulate(times)


@contextmanager
def progress_display(
    name: str, work: Sequence[float] | np.ndarray, quiet: bool, what: str = "observations", workers: int = 1
) -> Iterator[Show]:
    """Yield a function that shows the number of finished observations (or `what`) during the block.

    `work` is the work of each item, for the time left.
    """
    left = TimeLeft(work, workers)
    if quiet:
        yield lambda done, status, left_s=None: None
    elif not sys.stderr.isatty():
        yield _lines(name, len(work), what, left, complain)
    else:
        from surveysim.report.terminal.layout import Terminal

        console = Terminal(stderr=True)
        room = console.width - len(f"{name}{len(work)}{len(work)}") - STATUS_COLUMNS
        if room < SHORTEST_BAR or not console.is_interactive:
            yield _lines(name, len(work), what, left, console.say)
            return
        with _bar(name, len(work), left, console, min(room, 40)) as show:
            yield show


@contextmanager
def sweep_display(
    name: str, work: Sequence[float] | np.ndarray, quiet: bool, workers: int = 1, what: str = "points"
) -> Iterator[Callable[[int], None]]:
    """Yield a function that shows the number of finished points during the block, and ends an interrupted sweep."""
    with progress_display(name, work, quiet, what, workers) as show:
        yield stopping(lambda done: show(done, lambda: ""))


@contextmanager
def _bar(name: str, total: int, left: TimeLeft, console: "Terminal", length: int) -> Iterator[Show]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn
    from rich.text import Text

    class Remaining(ProgressColumn):
        """Time left, counted down between items."""

        def render(self, task: object) -> Text:
            seconds = left.now()
            return Text("" if seconds is None else time_text(seconds))

    columns = (
        TextColumn("{task.description}"),
        BarColumn(length),
        MofNCompleteColumn(),
        Remaining(),
        TextColumn("{task.fields[status]}"),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(name, total=total, status="")
        said = monotonic()

        def show(done: int, status: Callable[[], str], left_s: float | None = None) -> None:
            nonlocal said
            left.add(done, left_s)
            bar.start()  # again, if a pass over the survey has ended
            bar.update(task, completed=done)
            if done == total:
                bar.stop()  # its thread ends: a process of one thread draws figures beside another
            elif monotonic() - said > STATUS_EVERY_S:
                bar.update(task, status=status())
                said = monotonic()

        yield show


def _lines(name: str, total: int, what: str, left: TimeLeft, say: Callable[[str], None]) -> Show:
    every, said = max(1, total // LINES), monotonic()

    def show(done: int, status: Callable[[], str], left_s: float | None = None) -> None:
        nonlocal said
        seconds = left.add(done, left_s)
        if done % every == 0 or done == total:
            time = "" if seconds is None else f", {time_text(seconds)}"
            text = ""
            if done == total or monotonic() - said > STATUS_EVERY_S:  # the score takes a while
                text, said = status(), monotonic()
            say(f"{name}: {done}/{total} {what}{time}  {text}".rstrip())

    return show


def announce_compilation(name: str) -> None:
    """Report that kernels are compiled before the first result, unless they are cached."""
    from mapmaker.kernels.compiled import is_cached
    from mapmaker.kernels.pixels import bin_samples

    if not is_cached(bin_samples):
        complain(f"{name}: compiling kernels before the first result, up to a minute; later runs load them")


def show_solving(name: str, quiet: bool, what: str, iteration: int) -> None:
    """Print what is solved for, every few iterations."""
    if not quiet and iteration % SOLVED_EVERY == 0:
        complain(f"{name}: solving for {what}, iteration {iteration}")


def time_text(seconds: float) -> str:
    """Format a time as ``90 s left``, in minutes or hours if long."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit} left"
    return f"{seconds:.0f} s left"


def observation_work(scene: Scene) -> np.ndarray:
    """Work (n_obs,) of the observations, in units of one without signal simulations."""
    return np.where(signal_sim_observations(scene), SIGNAL_SIM_WORK, 1.0)


def seconds_left(sums: CoAddTree, work: np.ndarray, workers: int) -> float | None:
    """Estimate the time left of a run from the times that its finished observations took; None before the first.

    Observations are finished in any order, several at once where workers add them up.
    """
    finished = float(work[: sums.finished].sum())
    return sums.seconds / finished * (float(work.sum()) - finished) / workers if finished else None


def score_so_far(setup: Setup, sums: CoAddTree) -> str:
    """Format the quoted score of the actual data so far as ``sigma(A) = 270.1 +- 8.3 uK_CMB^2``; empty while its error
    is unknown.
    """
    with_sims = signal_sim_observations(setup.scene)[: sums.done].sum()
    if setup.scene.score is None or sums.done < 2 or with_sims < 2:
        return ""
    from surveysim.results.so_far import estimate_so_far

    found = estimate_so_far(setup, sums.so_far())
    if found is None or not math.isfinite(found.error_ukcmb2):
        return ""
    return f"sigma(A) = {plain(quoted(found.sigma_ukcmb2, found.error_ukcmb2))} uK_CMB^2"
