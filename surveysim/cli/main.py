"""Entry point: every failure, from the start of the program, ends in one line and an exit code."""

import gc
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from mapmaker.stop_signals import (
    EXIT_INTERRUPTED,
    TOO_LATE,
    asked_to_stop,
    end_at_signals,
    ignore_signals,
    interrupt_work,
    keep_exit_code,
)

WITHOUT_NOTICES = {"-q", "--quiet", "-h", "--help", "--version"}
COMPLETION = "_SURVEYSIM_COMPLETE"  # set by a shell that asks for completions


def main() -> NoReturn:
    """Run a command: exit code 0 for success, 2 for user errors, 1 for other errors, 130 when interrupted."""
    end_at_signals(_clean_up)
    from surveysim.runtime.environment import clean_up, settle

    notice = settle()
    try:
        code = ended(sys.argv[1:], notice)
    finally:
        clean_up()
    keep_exit_code()
    gc.freeze()  # Python searches all objects for cycles at exit, several times: a third of a short run
    sys.exit(code)


def _clean_up() -> None:
    """Remove what `settle` has made, if it has begun."""
    environment = sys.modules.get("surveysim.runtime.environment")  # an import here could wait for a running one
    if hasattr(environment, "clean_up"):
        environment.clean_up()


def ended(arguments: Sequence[str], notice: str | None = None) -> int:
    """Return the exit code of a command at its end; a failure prints one line to standard error.

    Signals are ignored from then on.
    """
    try:  # before anything else fails: there may be no memory left for imports then
        from mapmaker.printable import complain, printable
        from surveysim.cli.failures import broken_stream, failure
    except Exception as error:  # libraries that cannot be loaded
        os.write(2, f"surveysim can't start: {' '.join(str(error).split())[:200]!a}\n".encode())
        return 1

    try:
        if notice and not WITHOUT_NOTICES & set(arguments):
            complain(notice)
        code, message = _run(arguments), ""
        sys.stdout.flush()
        ignore_signals()
    except BaseException as error:
        ignore_signals()
        code, message = failure(error, arguments)
        for argument in arguments:  # a line break in a file name must not break the message
            message = message.replace(argument, printable(argument)) if "\n" in argument else message
    if asked_to_stop() and not code:
        code, message = EXIT_INTERRUPTED, TOO_LATE
    try:
        if message:
            complain(message)
    except OSError:
        broken_stream(sys.stderr)  # nowhere is left to say it
    return code


def _run(arguments: Sequence[str]) -> int:
    """Run a command and return its exit code."""
    from typer import Exit
    from typer.main import get_command

    from surveysim.cli.app import app
    from surveysim.cli.interrupts import EXIT_WRONG_SCENE, remember

    command = get_command(app)
    if COMPLETION in os.environ:
        command.main(list(arguments), "surveysim")
    remember(arguments)
    interrupt_work(_clean_up)
    try:
        with command.make_context("surveysim", list(arguments) or ["--help"]) as context:
            command.invoke(context)
    except Exit as end:
        return end.exit_code if arguments else EXIT_WRONG_SCENE
    return 0
