"""Failures of a command: an exit code and one line each; for a bug of this program also a file with the details."""

import os
import platform
import select
import sys
import tempfile
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, TextIO

import typer

from mapmaker.printable import LONGEST, printable, shortened
from mapmaker.stop_signals import EXIT_INTERRUPTED, asked_to_stop
from surveysim.cli.interrupts import EXIT_FAILED, EXIT_WRONG_SCENE, cause
from surveysim.runtime.errors import SceneError

EXIT_BROKEN_PIPE = 141  # as after SIGPIPE: 128 plus its number
UsageError: Any = typer.BadParameter.__bases__[0]  # its own name is private in some versions of typer


def failure(error: BaseException, arguments: Sequence[str]) -> tuple[int, str]:
    """Return the exit code of an error and the lines to print; none if they are printed already, or nobody reads."""
    broken = [name for name in ("stdout", "stderr") if broken_stream(getattr(sys, name))]
    if isinstance(error.__context__, BrokenPipeError) and isinstance(error, SystemExit):  # by rich
        return EXIT_BROKEN_PIPE, ""
    if isinstance(error, BrokenPipeError) and broken:
        return EXIT_BROKEN_PIPE, ""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else EXIT_FAILED, ""
    if isinstance(error, KeyboardInterrupt | typer.Abort) or asked_to_stop():
        return EXIT_INTERRUPTED, "interrupted"
    if isinstance(error, UsageError):
        return EXIT_WRONG_SCENE, _usage(error)
    if isinstance(error, SceneError):
        return EXIT_WRONG_SCENE, str(error)
    line = _of_the_machine(error, broken) or _fault(error, arguments)
    notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
    return EXIT_FAILED, f"{shortened(line, max(LONGEST // 2, LONGEST - len(notes)))}{notes}"


def broken_stream(stream: TextIO) -> bool:
    """Return whether a standard stream cannot be written or has no reader; if so, Python does not flush it at exit."""
    try:
        stream.flush()
        broken = _unread(stream)
    except OSError:
        broken = True
    if broken:
        with suppress(OSError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
    return broken


def _unread(stream: TextIO) -> bool:
    """Return whether a stream is a pipe whose reader is gone."""
    try:
        number = stream.fileno()
    except OSError:  # a stream that is no file
        return False
    if not hasattr(select, "poll"):
        return False
    poll = select.poll()
    poll.register(number, 0)
    return any(found & select.POLLERR for _, found in poll.poll(0))


def _usage(error: Any) -> str:
    command = error.ctx.command_path if error.ctx else "surveysim"
    return f"{' '.join(error.format_message().split())} ('{command} --help' says more)"


def _of_the_machine(error: BaseException, broken: list[str]) -> str:
    """Return the line of an error of the operating system; empty for other errors."""
    from surveysim.runtime.engine import EngineError

    if isinstance(error, MemoryError) or (isinstance(error, ImportError) and "failed to map" in str(error)):
        return "not enough memory for this scene; 'surveysim plan SCENE' says how much it needs"
    if isinstance(error, OSError) and not error.filename and "stdout" in broken:
        return f"standard output: {error.strerror}"
    if isinstance(error, OSError):
        return cause(error)
    return str(error) if isinstance(error, EngineError) else ""


def _fault(error: BaseException, arguments: Sequence[str]) -> str:
    """Return a line about an unexpected error, and the file with its details."""
    said = shortened(printable(f"{type(error).__name__}: {error}"), 200)
    try:
        path = write_details(error, arguments)
    except OSError as reason:
        return f"surveysim can't go on: {said} (its details can't be written: {reason.strerror})"
    return f"surveysim can't go on: {said}; please report it with its details in {path}"


def write_details(error: BaseException, arguments: Sequence[str]) -> str:
    """Write traceback, versions and command line to a new temporary file; return its path."""
    from surveysim import __version__

    number, path = tempfile.mkstemp(prefix="surveysim-error-", suffix=".txt")
    with open(number, "w", encoding="utf-8", errors="backslashreplace") as file:
        file.write(f"surveysim {__version__}, Python {platform.python_version()}, {platform.platform()}\n")
        file.write(f"arguments: {list(arguments)!r}\n\n")
        file.writelines(traceback.format_exception(error))
    return path
