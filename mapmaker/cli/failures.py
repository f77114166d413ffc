"""Failures of a command: an exit code and one line each; for a bug of this program also a file with the details."""

import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Sequence
from typing import Any

import typer

from mapmaker.cli.main import EXIT_FAILED, EXIT_WRONG_INPUT
from mapmaker.errors import ArgumentError, InputError
from mapmaker.printable import printable, shortened
from mapmaker.stop_signals import EXIT_INTERRUPTED, asked_to_stop

EXIT_BROKEN_PIPE = 141  # as after SIGPIPE: 128 plus its number
UsageError: Any = typer.BadParameter.__bases__[0]  # its own name is private in some versions of typer


def failure(error: BaseException, arguments: Sequence[str]) -> tuple[int, str]:
    """Return the exit code of an error and the line to print; empty if it is printed already, or nobody reads."""
    if isinstance(error, BrokenPipeError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE, ""
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else EXIT_FAILED, ""
    if isinstance(error, KeyboardInterrupt | typer.Abort) or asked_to_stop():
        return EXIT_INTERRUPTED, "; ".join(["interrupted", *getattr(error, "__notes__", ())])
    if isinstance(error, UsageError):
        command = error.ctx.command_path if error.ctx else "mapmaker"
        return EXIT_WRONG_INPUT, f"{' '.join(error.format_message().split())} ('{command} --help' says more)"
    if isinstance(error, InputError) and not isinstance(error, ArgumentError):
        return EXIT_WRONG_INPUT, str(error)
    if isinstance(error, MemoryError):
        return EXIT_FAILED, "not enough memory"
    if isinstance(error, OSError):
        return EXIT_FAILED, f"{error.filename or 'output'}: {error.strerror or error}"
    return EXIT_FAILED, _fault(error, arguments)


def _fault(error: BaseException, arguments: Sequence[str]) -> str:
    """Return a line about an unexpected error, and the file with its details."""
    said = shortened(printable(f"{type(error).__name__}: {error}"), 200)
    number, path = tempfile.mkstemp(prefix="mapmaker-error-", suffix=".txt")
    with open(number, "w", encoding="utf-8", errors="backslashreplace") as file:
        file.write(f"Python {platform.python_version()}, {platform.platform()}\narguments: {list(arguments)!r}\n\n")
        file.writelines(traceback.format_exception(error))
    return f"mapmaker can't go on: {said}; please report it with its details in {path}"
