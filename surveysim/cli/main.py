"""Entry point: every failure, from the start of the program, ends in one line and an exit code."""

import gc
import os
import signal
import sys
from collections.abc import Sequence
from typing import NoReturn

WITHOUT_NOTICES = {"-q", "--quiet", "-h", "--help", "--version"}
COMPLETION = "_SURVEYSIM_COMPLETE"  # set by a shell that asks for completions


def main() -> NoReturn:
    """Run a command: exit code 0 for success, 2 for user errors, 1 for other errors, 130 when interrupted."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _interrupted_at_start)
    from surveysim.runtime.environment import clean_up, settle

    notice = settle()
    try:
        code = ended(sys.argv[1:], notice)
    finally:
        clean_up()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)  # the command is done
    gc.freeze()  # Python searches all objects for cycles at exit, several times: a third of a short run
    sys.exit(code)


def _interrupted_at_start(number: int, frame: object) -> NoReturn:
    """End at once: no work has begun, and a library that is being imported could lose or wrap an exception."""
    environment = sys.modules.get("surveysim.runtime.environment")  # an import here could wait for a running one
    if hasattr(environment, "clean_up"):
        environment.clean_up()
    try:
        os.write(2, b"interrupted\n")
    finally:
        os._exit(130)


def ended(arguments: Sequence[str], notice: str | None = None) -> int:
    """Return the exit code of a command at its end; a failure prints one line to standard error."""
    try:  # before anything else fails: there may be no memory left for imports then
        from mapmaker.printable import complain, printable
        from surveysim.cli.failures import broken_stream, failure
    except Exception as error:  # libraries that cannot be loaded
        os.write(2, f"surveysim can't start: {' '.join(str(error).split())[:200]!a}\n".encode())
        return 1

    try:
        if notice and not WITHOUT_NOTICES & set(arguments):
            complain(notice)
        code = _run(arguments)
        sys.stdout.flush()
    except BaseException as error:
        code, message = failure(error, arguments)
        for argument in arguments:  # a line break in a file name must not break the message
            message = message.replace(argument, printable(argument)) if "\n" in argument else message
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
    from surveysim.cli.interrupts import EXIT_WRONG_SCENE, listen

    command = get_command(app)
    if COMPLETION in os.environ:
        command.main(list(arguments), "surveysim")
    listen(arguments)
    try:
        with command.make_context("surveysim", list(arguments) or ["--help"]) as context:
            command.invoke(context)
    except Exit as end:
        return end.exit_code if arguments else EXIT_WRONG_SCENE
    return 0
