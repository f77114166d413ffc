"""Signals and worker processes: deferred signals, and workers that ignore Ctrl-C and do not run the calling script."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import ModuleType

from mapmaker.stop_signals import NUMBERS


@contextmanager
def defer_signals() -> Iterator[None]:
    """Defer SIGINT and SIGTERM to the end of the block, so that its changes are never left incomplete."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[int] = []
    previous = {number: signal.signal(number, lambda number, frame: waiting.append(number)) for number in NUMBERS}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    if waiting:
        signal.raise_signal(waiting[0])


@contextmanager
def ignore_sigint_in_children() -> Iterator[None]:
    """Let threads and processes that are started in the block ignore SIGINT.

    A terminal sends SIGINT to the whole process group, and the parent decides what happens. Children inherit the signal
    mask of the block.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # unblocks signals when it is started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def hide_main_module() -> Iterator[None]:
    """Let processes that are started in the block not import the calling script, which they do not need.

    A script without ``if __name__ == "__main__":`` would start workers of its own, and a script that was read from
    standard input can't be read again.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script
