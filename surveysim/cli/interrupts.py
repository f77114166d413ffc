"""Early ends of a command: requests to stop, lost workers, outputs that can't be written."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from errno import EMFILE, ENFILE
from pathlib import Path
from threading import Event
from typing import Any, NoReturn

import typer

from surveysim.runtime.errors import InputError, SceneError
from surveysim.runtime.printable import complain

EXIT_FAILED = 1
EXIT_WRONG_SCENE = 2
EXIT_INTERRUPTED = 130

_asked_to_stop = Event()


def listen() -> None:
    """Take Ctrl-C and a batch system's request to stop alike: what is finished is kept."""
    _asked_to_stop.clear()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _stop_once)


def _stop_once(number: int, frame: object) -> None:
    """Interrupt the run; a second Ctrl-C would only cut short the saving of its checkpoint."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    _asked_to_stop.set()
    raise KeyboardInterrupt  # lost in a finalizer, or wrapped by an import: `stopping` raises it again


def asked_to_stop() -> bool:
    """Return whether this process was interrupted since it listens."""
    return _asked_to_stop.is_set()


def stopping(show: Callable[..., None]) -> Callable[..., None]:
    """Progress that ends a run whose interrupt was lost in a finalizer."""

    def progress(*state: Any) -> None:
        if _asked_to_stop.is_set():
            raise KeyboardInterrupt
        show(*state)

    return progress


@contextmanager
def report_resumable_exit(scene: Path, directory: Path) -> Iterator[None]:
    """End with one line where a run stops: why, and how to go on if anything is kept in `directory`."""
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


def _stopped(reason: str, directory: Path, code: int) -> NoReturn:
    """Say why a run stopped and how to go on."""
    from surveysim.output.directory import holds_work

    hint = f"; go on with --resume --out {directory}" if holds_work(directory) else ""
    complain(" ".join(reason.split()) + hint)
    raise typer.Exit(code)


def report_new_start(directory: Path, kept: str, first: str) -> None:
    """Say that there is nothing to resume, so that the work starts anew."""
    from surveysim.output.directory import holds_work

    if not holds_work(directory) and not (directory / "summary.json").exists():
        complain(f"no {kept} in {directory}: starting with the first{first}")


def cause(error: OSError, directory: Path = Path("output")) -> str:
    """The file of an error of the machine, or else the folder, and what is wrong with it."""
    if error.errno in (EMFILE, ENFILE):
        return (
            f"{error.filename or directory}: too many open files; raise the limit ('ulimit -n') or take fewer workers"
        )
    if isinstance(error, FileNotFoundError) and not error.filename:
        return "the working directory is gone; change to another"
    return f"{error.filename or directory}: {error.strerror or str(error).partition('. ')[0]}"
