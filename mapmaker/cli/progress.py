"""Progress of a command: a bar on a terminal, one line at a time elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mapmaker.printable import complain

LINES = 10  # most lines for each part of the work
Show = Callable[[str, int, int], None]  # told what is done, the number of files that are finished, and of all


@contextmanager
def progress_display(quiet: bool) -> Iterator[Show]:
    """Yield a function that shows what is done with some files."""
    if quiet:
        yield lambda what, done, total: None
    elif not sys.stderr.isatty():
        yield _show_line
    else:
        with _bar() as show:
            yield show


def _show_line(what: str, done: int, total: int) -> None:
    if not total:
        if str(done).rstrip("0") in ("", "1", "2", "5"):  # the number of passes is not known before
            complain(f"{what} {done}" if done else what)
    elif done % max(1, total // LINES) == 0 or done == total:
        complain(f"{what}: {done}/{total} files")


@contextmanager
def _bar() -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True)) as bar:
        tasks: dict[str, int] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total or None)
            bar.update(tasks[what], completed=done)  # type: ignore[arg-type]

        yield show
