"""Figures of results, drawn by two processes where that is safe: together they take as long as a small survey."""

import gc
import logging
import os
import signal
from collections.abc import Callable, Iterator
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter

from surveysim.runtime.engine import default_workers
from surveysim.runtime.text_files import one_line

Drawings = dict[str, Callable[[Path], Any]]  # what draws a figure as a PNG, by its name
Outcome = tuple[str, str | None]  # name of a figure, and the reason why it can't be drawn

FEW = 4  # figures that one process draws about as soon as two
REASON = 120  # letters of the reason why a figure can't be drawn
THREADS = Path("/proc/self/task")  # of this process, on Linux
log = logging.getLogger("surveysim")


def draw(directory: Path, figures: Callable[[], Drawings] | None, files: list[Path], warnings: list[str]) -> None:
    """Draw what can be drawn in a directory; adds to the `files`, or to the `warnings`."""
    try:
        drawings = figures() if figures else {}
    except Exception as error:  # of a library for figures that can't be loaded
        warnings.append(undrawn("figures", error))
        return
    gc.freeze()  # collections after each figure then skip all objects but those of figures
    try:
        for name, reason in _drawn(directory, drawings):
            if reason is None:
                files.append(_place(directory, name))
            else:
                warnings.append(_told(f"figure {name!r}", reason))
    finally:
        gc.unfreeze()


def undrawn(what: str, error: Exception) -> str:
    """Warn that something could not be drawn; returns the line."""
    return _told(what, _reason(error))


def _drawn(directory: Path, drawings: Drawings) -> Iterator[Outcome]:
    """Draw figures, each second one in another process if there are many of them and a fork is safe."""
    if len(drawings) < FEW or not _may_fork():
        yield from _in_turn(directory, drawings)
        return
    names = list(drawings)
    mine, others = ({name: drawings[name] for name in names[first::2]} for first in (0, 1))
    ours, theirs = get_context("fork").Pipe(duplex=False)
    process = get_context("fork").Process(target=_draw_for, args=(theirs, directory, others), daemon=True)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # this process decides what an interrupt does
    try:
        process.start()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()  # held by the other process alone: its end closes with it
    try:
        yield from _in_turn(directory, mine)
        yield from _answer(ours) or _in_turn(directory, others)
    finally:
        process.kill()
        process.join()
        ours.close()


def _may_fork() -> bool:
    """Return whether a second core is there, and this process has one thread: others could hold locks for ever."""
    forks = "fork" in get_all_start_methods() and THREADS.is_dir()
    return forks and default_workers() > 1 and len(os.listdir(THREADS)) == 1


def _draw_for(parent: Connection, directory: Path, drawings: Drawings) -> None:
    parent.send(list(_in_turn(directory, drawings)))


def _answer(channel: Connection) -> list[Outcome]:
    """Wait for the outcomes of another process; none if it was killed."""
    try:
        found: list[Outcome] = channel.recv()
    except EOFError:
        return []
    return found


def _in_turn(directory: Path, drawings: Drawings) -> Iterator[Outcome]:
    for name, draw_it in drawings.items():
        try:
            with catch_warnings():
                simplefilter("ignore")  # of letters that no font has, and labels that have no room
                draw_it(_place(directory, name))
        except Exception as error:  # matplotlib raises a wide range: of fonts, formulas, sizes
            yield name, _reason(error)
        else:
            yield name, None


def _place(directory: Path, name: str) -> Path:
    return directory / f"{name}.png"


def _reason(error: Exception) -> str:
    told = f": {one_line(error, REASON)}" if str(error).strip() else ""
    return f"{type(error).__name__}{told}"


def _told(what: str, reason: str) -> str:
    line = f"{what} can't be drawn ({reason}); all else is written"
    log.warning(line)
    return line
