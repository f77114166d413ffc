"""Early ends of a command: stop signals, lost workers, outputs that cannot be written."""

import shlex
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from errno import EMFILE, ENFILE
from pathlib import Path
from typing import Any, NoReturn

import typer

from mapmaker.printable import complain
from mapmaker.stop_signals import EXIT_INTERRUPTED, asked_to_stop
from surveysim.runtime.errors import InputError, SceneError

EXIT_FAILED = 1
EXIT_WRONG_SCENE = 2
NOTHING_KEPT = "no work is kept, the same command starts anew"

_arguments: list[str] = []  # of the command, for the hint how to resume it


def remember(arguments: Sequence[str]) -> None:
    """Remember the command line for `resuming_command`."""
    _arguments[:] = arguments


def stopping(show: Callable[..., None]) -> Callable[..., None]:
    """Wrap a progress function to end a run whose interrupt was lost in a finalizer."""

    def progress(*state: Any) -> None:
        if asked_to_stop():
            raise KeyboardInterrupt
        show(*state)

    return progress


@contextmanager
def report_resumable_exit(scene: Path, directory: Path) -> Iterator[None]:
    """End with one line if a run stops: the reason, and how to resume if `directory` has kept work."""
    from surveysim.output.directory import FinishedError
    from surveysim.runtime.engine import EngineError
    from surveysim.survey.checkpoint import CheckpointError

    try:
        yield
    except FinishedError as error:
        complain(str(error))
        raise typer.Exit() from None
    except SceneError:
        raise
    except CheckpointError as error:
        raise SceneError(str(error)) from None
    except KeyboardInterrupt:
        _stopped("interrupted", directory, EXIT_INTERRUPTED)
    except EngineError as error:
        _stopped(str(error), directory, EXIT_FAILED)
    except OSError as error:
        _stopped(cause(error, directory), directory, EXIT_FAILED)
    except InputError as error:
        _stopped(f"{scene}: an observation failed: {error}", directory, EXIT_FAILED)
    except Exception as error:  # of a library, such as numpy's; the line of the failure has the note
        if hint := _hint(directory):
            error.add_note(hint)
        raise


def _hint(directory: Path) -> str:
    """Return the command that resumes the work kept in `directory`; empty if there is none."""
    from surveysim.output.directory import holds_work

    return f"go on with: {resuming_command(_arguments, directory)}" if holds_work(directory) else ""


def resuming_command(arguments: Sequence[str], directory: Path) -> str:
    """Return the command line with these arguments that continues from `directory`, to be pasted into a shell."""
    kept = [text for text in arguments if text not in ("--resume", "--force")]
    out = [] if any(text.partition("=")[0] == "--out" for text in kept) else ["--out", str(directory)]
    return shlex.join(["surveysim", *kept, *out, "--resume"])


def _stopped(reason: str, directory: Path, code: int) -> NoReturn:
    """Report why a run stopped and how to resume it; an interrupt that became another error is one all the same."""
    if asked_to_stop() and code != EXIT_INTERRUPTED:
        reason, code = f"interrupted: {reason}", EXIT_INTERRUPTED
    hint = _hint(directory) or (NOTHING_KEPT if code == EXIT_INTERRUPTED else "")
    complain("; ".join([" ".join(reason.split()), *([hint] if hint else [])]))
    raise typer.Exit(code)


def report_new_start(directory: Path, kept: str, first: str) -> None:
    """Report that there is nothing to resume, so that the work starts anew."""
    from surveysim.output.directory import holds_work

    if not holds_work(directory) and not (directory / "summary.json").exists():
        complain(f"no {kept} in {directory}: starting with the first{first}")


def cause(error: OSError, directory: Path = Path("output")) -> str:
    """Return the file of an operating system error, or else the folder, and the reason."""
    if error.errno in (EMFILE, ENFILE):
        return (
            f"{error.filename or directory}: too many open files; raise the limit ('ulimit -n') or take fewer workers"
        )
    if isinstance(error, FileNotFoundError) and not error.filename:
        return "the working directory is gone; change to another"
    return f"{error.filename or directory}: {error.strerror or str(error).partition('. ')[0]}"
