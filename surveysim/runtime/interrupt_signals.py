"""Signals that wait, and workers that are deaf to Ctrl-C and do not run the calling script."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from types import ModuleType


@contextmanager
def defer_signals() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the end of the block, so that what it changes is never half done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[int] = []
    previous = {
        number: signal.signal(number, lambda number, frame: waiting.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    if waiting:
        signal.raise_signal(waiting[0])


@contextmanager
def deaf_children() -> Iterator[None]:
    """Threads and processes that are started in the block never see Ctrl-C.

    A terminal sends it to the whole process group, and the parent decides what happens: a signal that is blocked
    here is so in them.
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
def without_script() -> Iterator[None]:
    """Processes that are started in the block do not import the calling script.

    They need nothing of it. Importing runs it: without ``if __name__ == "__main__":`` it would start workers of its
    own, and one that was read from standard input can't be read again.
    """
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script
