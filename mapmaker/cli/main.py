"""Entry point of ``mapmaker``: every failure ends in one line and an exit code."""

import gc
import os
import sys
import warnings
from collections.abc import Sequence
from typing import NoReturn

from mapmaker.stop_signals import (
    EXIT_INTERRUPTED,
    TOO_LATE,
    asked_to_stop,
    ignore_signals,
    interrupt_work,
    keep_exit_code,
)

EXIT_FAILED, EXIT_WRONG_INPUT = 1, 2


def main() -> NoReturn:
    """Run a command: exit code 0 for success, 2 for user errors, 1 for other errors, 130 when interrupted."""
    interrupt_work()
    warnings.simplefilter("ignore")  # of libraries; errors of input have a line of their own
    code = ended(sys.argv[1:])
    keep_exit_code()
    gc.freeze()  # Python searches all objects for cycles at exit, several times: a third of a short command
    sys.exit(code)


def ended(arguments: Sequence[str]) -> int:
    """Return the exit code of a command at its end; a failure prints one line to standard error.

    Signals are ignored from then on.
    """
    try:
        code, message = _run(arguments), ""
        sys.stdout.flush()
        ignore_signals()
    except BaseException as error:
        ignore_signals()
        from mapmaker.cli.failures import failure

        code, message = failure(error, arguments)
    if asked_to_stop() and not code:
        code, message = EXIT_INTERRUPTED, TOO_LATE
    if message:
        from mapmaker.printable import complain

        complain(message)
    return code


def _run(arguments: Sequence[str]) -> int:
    from typer import Exit
    from typer.main import get_command

    from mapmaker.cli.app import app

    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # it reads the metadata of all packages for them
    command = get_command(app)
    try:
        with command.make_context("mapmaker", list(arguments) or ["--help"]) as context:
            command.invoke(context)
    except Exit as end:
        return end.exit_code if arguments else EXIT_WRONG_INPUT
    return 0
