"""Entry point of ``mapmaker``: every failure ends in one line and an exit code."""

import gc
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import NoReturn

EXIT_FAILED, EXIT_WRONG_INPUT, EXIT_INTERRUPTED = 1, 2, 130


def main() -> NoReturn:
    """Run a command: exit code 0 for success, 2 for user errors, 1 for other errors, 130 when interrupted."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupt)
    warnings.simplefilter("ignore")  # of libraries; errors of input have a line of their own
    code = ended(sys.argv[1:])
    gc.freeze()  # Python searches all objects for cycles at exit, several times: a third of a short command
    sys.exit(code)


def _interrupt(number: int, frame: object) -> NoReturn:
    """Interrupt the command, once: a second Ctrl-C would interrupt the removal of unfinished files."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    raise KeyboardInterrupt


def ended(arguments: Sequence[str]) -> int:
    """Return the exit code of a command at its end; a failure prints one line to standard error."""
    try:
        code = _run(arguments)
        sys.stdout.flush()
        return code
    except BaseException as error:
        from mapmaker.cli.failures import failure
        from mapmaker.printable import complain

        code, message = failure(error, arguments)
        if message:
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
