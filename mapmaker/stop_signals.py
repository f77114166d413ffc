"""Ctrl-C and SIGTERM of a command: the first interrupts its work, a second one ends it at once, and none is lost.

This module imports next to nothing: a command handles signals before it imports anything else.
"""

import os
import signal
from collections.abc import Callable
from functools import partial
from time import monotonic
from typing import NoReturn

EXIT_INTERRUPTED = 130
TOO_LATE = "interrupted too late: the command is finished"
SAME_S = 0.2  # a signal as soon after the first is the same: a terminal and a wrapper of the command both send it
SHOW_CURSOR = b"\x1b[?25h"  # which a progress bar hides

NUMBERS = (signal.SIGINT, signal.SIGTERM)
_asked: list[float] = []  # time of the first signal since `interrupt_work` [s]


def end_at_signals(clean_up: Callable[[], None] = lambda: None) -> None:
    """End the process at the first signal, after `clean_up`: imports could lose or wrap a KeyboardInterrupt."""
    for number in NUMBERS:
        signal.signal(number, partial(_end, clean_up))


def interrupt_work(clean_up: Callable[[], None] = lambda: None) -> None:
    """Raise KeyboardInterrupt at the first signal from now on; a second one ends the process, after `clean_up`."""
    _asked.clear()
    for number in NUMBERS:
        signal.signal(number, partial(_interrupt, clean_up))


def ignore_signals() -> None:
    """Ignore signals from now on: the work is done."""
    for number in NUMBERS:
        signal.signal(number, signal.SIG_IGN)


def asked_to_stop() -> bool:
    """Return whether there was a signal since `interrupt_work`.

    Its KeyboardInterrupt may be lost: Python ignores exceptions in finalizers, and libraries catch errors of imports.
    """
    return bool(_asked)


def keep_exit_code() -> None:
    """Let ``python -m`` end with the exit code of the command.

    Once a KeyboardInterrupt has left an ``exec`` of text, as named tuples and data classes have, Python ends by SIGINT,
    even if it was caught. The next ``exec`` resets that.
    """
    exec("")


def _interrupt(clean_up: Callable[[], None], number: int, frame: object) -> None:
    if not _asked:
        _asked.append(monotonic())
        raise KeyboardInterrupt
    if monotonic() - _asked[0] > SAME_S:
        _end(clean_up, number, frame)


def _end(clean_up: Callable[[], None], number: int, frame: object) -> NoReturn:
    try:
        clean_up()
        os.write(2, (SHOW_CURSOR if os.isatty(2) else b"") + b"interrupted\n")
    finally:
        os._exit(EXIT_INTERRUPTED)
