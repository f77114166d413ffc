"""Progress of a command: a bar on a terminal, one line at a time elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from mapmaker.printable import complain

LINES = 10  # most lines for each part of the work
Show = Callable[[str, int], None]  # told what is done, and the number of files that are finished


@contextmanager
def progress_display(total: int, quiet: bool) -> Iterator[Show]:
    """Yield a function that shows what is done with some files."""
    if quiet:
        yield lambda what, done: None
    elif not sys.stderr.isatty():
        yield _lines(total)
    else:
        with _bar(total) as show:
            yield show


def _lines(total: int) -> Show:
    every = max(1, total // LINES)

    def show(what: str, done: int) -> None:
        if not done:
            complain(f"{what} results")
        elif done % every == 0 or done == total:
            complain(f"{what}: {done}/{total} files")

    return show


@contextmanager
def _bar(total: int) -> Iterator[Show]:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=Console(stderr=True)) as bar:
        tasks: dict[str, int] = {}

        def show(what: str, done: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total if done else None)
            bar.update(tasks[what], completed=done)  # type: ignore[arg-type]

        yield show
