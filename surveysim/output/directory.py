"""Output directories: one job at a time writes to a directory, and replaces only its own earlier results.

A hidden file, `.surveysim.json`, records the command and the scene that wrote the directory, and lists each file with
its SHA-256. A file is removed only if it is listed there, has a name that this program writes, and is unchanged. Links
are never followed. Results are written to a temporary folder and moved to their places together.
"""

import logging
import os
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from errno import EACCES, EISDIR, ENOTDIR
from hashlib import file_digest, sha256
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import Any

from mapmaker.files import atomic_write
from surveysim.output.file_names import INPUT, NEW, SAYS_ITSELF, UNFINISHED_WORK, WRITTEN
from surveysim.output.lock import OutputError, locked
from surveysim.output.partial_files import remove_partial_files
from surveysim.output.record import (
    NOTHING,
    RECORD,
    Results,
    is_regular,
    read_record,
    rewrite_record,
    write_record,
)
from surveysim.scene.units import shown
from surveysim.survey.checkpoint import NAME as CHECKPOINT
from surveysim.survey.checkpoint import WEIGHTS

OTHERWISE = "--force replaces it, --out writes elsewhere"

log = logging.getLogger("surveysim")


class FinishedError(OutputError):
    """The run is finished: there is nothing to resume."""


@dataclass(frozen=True)
class OutputDirectory:
    """A directory that this process has locked.

    `mine` are unchanged files that this program wrote, with an identity of their content (None if a killed job may or
    may not have written them). `others` are files of the user that `--force` allows to replace, with an identity that
    shows whether they have been replaced.
    """

    path: Path
    results: Results
    mine: dict[str, str | None]
    others: dict[str, tuple[int, int]]


@contextmanager
def claimed(directory: Path, results: Results, force: bool = False, resume: bool = False) -> Iterator[OutputDirectory]:
    """Make and lock a directory for the results of a command, until the end of the block.

    Raises
    ------
    OutputError
        For a directory that another job writes to, or with links in place of its folders. Unless with `force`: for
        results of another scene or command, an unfinished run, or files of the user with names to be written.
    FinishedError
        With `resume`, for a finished run.
    OSError
        If the directory cannot be written.
    """
    if force and resume:
        raise OutputError(f"{directory}: found both resume and force; a run goes on, or is replaced")
    _make(directory)
    with locked(directory):
        place = _claim(directory, results, force, resume)
        remove_partial_files(place.path, place.results.all_names)
        try:
            yield place
        finally:
            remove_partial_files(place.path, place.results.all_names)  # from killed workers


def begin(place: OutputDirectory, removed: Callable[[str], bool]) -> None:
    """Remove earlier results named in `removed`, write the inputs, and record that the work is unfinished."""
    results = place.results
    stay = {name: known for name, known in place.mine.items() if name in results.inputs or not removed(name)}
    remove(place, place.mine.keys() - stay.keys())
    coming = [name for name in results.names if results.piecewise or UNFINISHED_WORK.fullmatch(name)]
    inputs = {name: sha256(content).hexdigest() for name, content in results.inputs.items()}
    write_record(place.path, place.results, stay | dict.fromkeys(coming) | inputs, finished=False)
    for name, content in results.inputs.items():
        with atomic_write(place.path / name) as partial:
            partial.write_bytes(content)


@contextmanager
def replacing(
    place: OutputDirectory, over: Callable[[str], bool] = lambda name: False, whole: bool = True
) -> Iterator[Path]:
    """Yield a temporary folder for results; at the end of the block they replace earlier ones, or none does after an
    error.

    Points in `over` are no longer needed and are removed with the remaining earlier results. Results that are not
    `whole` can be resumed.
    """
    new = place.path / f"{NEW}.{os.getpid()}.part"
    new.mkdir()
    try:
        for name, content in place.results.inputs.items():
            (new / name).write_bytes(content)
        yield new
    except OSError as error:  # name the file by its final place
        path = str(error.filename or place.path).replace(str(new), str(place.path))
        raise OSError(error.errno, error.strerror or str(error), path) from None
    _put_in_place(place, new, over, whole)


def _put_in_place(place: OutputDirectory, new: Path, over: Callable[[str], bool], whole: bool) -> None:
    written = {path.relative_to(new).as_posix(): _identity(path) for path in new.rglob("*") if path.is_file()}
    work = [name for name in place.results.names if UNFINISHED_WORK.fullmatch(name) and _is_written(place, name)]
    files = written | {name: _identity(place.path / name) for name in work if not over(name)}
    gone = {name: place.mine.get(name) for name in (*place.mine, *work) if name not in files}
    write_record(place.path, place.results, files | gone, finished=False)
    for name in written:
        (place.path / name).parent.mkdir(exist_ok=True)
        (new / name).replace(place.path / name)
    remove(place, gone)
    write_record(place.path, place.results, files, finished=True, whole=whole)


def finish(place: OutputDirectory) -> None:
    """Record the files that a piecewise job has written."""
    names = dict.fromkeys((*place.mine, *place.results.all_names))
    files = {name: _identity(place.path / name) for name in names if _is_written(place, name)}
    write_record(place.path, place.results, files, finished=True)


def remove(place: OutputDirectory, names: Iterable[str]) -> None:
    """Remove files that this program wrote, and the folder of a sweep's points when it is empty."""
    points = False
    for name in names:
        if _may_be_removed(place.path, name):
            (place.path / name).unlink(missing_ok=True)
            points |= name.startswith("points/")
    if points and not any((place.path / "points").iterdir()):
        (place.path / "points").rmdir()


def remove_nested(directory: Path, kept: Container[str] = ()) -> None:
    """Remove the results of points of a sweep, and of bands that are not `kept`.

    What this program wrote there goes, and folders left empty.
    """
    for folder in (*directory.glob("bands/*"), *directory.glob("points/*")):
        if folder.is_dir() and not folder.parent.is_symlink() and folder.name not in kept:
            _remove_nested(folder)


def _remove_nested(folder: Path) -> None:
    record = None if folder.is_symlink() else read_record(folder)
    if record is None:
        return
    remove_nested(folder)
    with locked(folder):
        for name in record["files"]:
            if _is_mine(folder, name, record["files"]):
                (folder / name).unlink()
        (folder / RECORD).unlink()
    for place in (*(path for path in folder.iterdir() if path.is_dir()), folder, folder.parent):
        with suppress(OSError):  # files of the user stay
            place.rmdir()


@contextmanager
def renewed(directory: Path, name: str, force: bool = False) -> Iterator[None]:
    """Lock a directory of results while one of its files is rewritten.

    Raises OutputError for a file of the user with that name (unless with `force`), and for anything but a regular file.
    """
    if not directory.is_dir():
        yield  # the block raises its error
        return
    with locked(directory):
        record = read_record(directory) or NOTHING
        _check_readable(directory)
        known = record["files"]
        if os.path.lexists(directory / name) and not force and not _is_mine(directory, name, known):
            raise OutputError(f"{directory / name}: not written by this program, or changed since; --force replaces it")
        yield
        if record is not NOTHING:
            files = known | {name: _identity(directory / name)}
            rewrite_record(directory, record | {"files": files})


def holds_work(directory: Path) -> bool:
    """Return whether a directory has files to resume from: a checkpoint, or points of a sweep."""
    patterns = (CHECKPOINT, "points/*.npz", "points/*.checkpoint.h5", "evaluations.jsonl")
    places = [directory, *directory.glob("bands/*")]
    return any(path.is_file() for place in places for pattern in patterns for path in place.glob(pattern))


# ---------------------------------------------------------------- whose a directory is


def _claim(path: Path, results: Results, force: bool, resume: bool) -> OutputDirectory:
    _check_folders(path, results.all_names)
    record = read_record(path)
    if record is None and os.path.lexists(path / RECORD) and not force:
        raise OutputError(f"{path / RECORD}: not written by this program; {OTHERWISE}")
    record = record or NOTHING
    mine = {name: known for name, known in record["files"].items() if _is_mine(path, name, record["files"])}
    started = record["finished"] or any(not INPUT.fullmatch(name) for name in mine)
    if record is not NOTHING and started and not force:
        _check_same(path, results, record, resume)
        _check_unfinished(path, mine, record, resume=resume, same=record["sha256"] == results.sha256)
    if resume:
        mine |= {name: None for name in results.names if SAYS_ITSELF.fullmatch(name) and _may_be_removed(path, name)}
    others = _others(path, results, mine, force)
    for name in record["files"].keys() - mine.keys() - others.keys():
        if os.path.lexists(path / name) and WRITTEN.fullmatch(name):
            log.warning("%s: changed since it was written; it stays", path / name)
    return OutputDirectory(path, results, mine, others)


def _check_same(path: Path, results: Results, record: Mapping[str, Any], resume: bool) -> None:
    """Raise OutputError for a directory of another command or scene; `resume` may change the number of observations."""
    extends = bool(results.extends) and record.get("extends") == results.extends
    kind = "results" if record["finished"] else "an unfinished run"
    if record["command"] != results.command:
        found = f"{kind} of {shown('surveysim ' + record['command'])}"
    elif record["sha256"] != results.sha256 and not (extends and resume):
        name = shown(record["scene"])
        other = f"{name} with other settings" if record["scene"] == results.scene else f"another scene, {name}"
        found = f"{kind} of {other}"
    else:
        return
    hint = "--resume changes the number of observations, " if extends else ""
    raise OutputError(f"{path}: holds {found}; {hint}--force replaces them, --out writes elsewhere")


def _check_unfinished(
    path: Path, mine: Mapping[str, str | None], record: Mapping[str, Any], *, resume: bool, same: bool
) -> None:
    """Raise OutputError if unfinished work would be lost without `resume`, FinishedError if there is none to resume.

    A run has both results and a checkpoint. One that stopped early is not whole.
    """
    whole = record["finished"] and record.get("whole", CHECKPOINT not in mine)
    if resume and record["finished"] and ((whole and same) or not holds_work(path)):
        raise FinishedError(f"{path}: the run is finished; there is nothing to resume")
    work = [name for name in mine if UNFINISHED_WORK.fullmatch(name)]
    if not resume and work and not whole and (CHECKPOINT in work or not record["finished"]):
        raise OutputError(
            f"{path / work[0]}: from a run that has not finished; --resume goes on from there, --force starts anew, "
            "--out writes elsewhere"
        )


def _others(path: Path, results: Results, mine: Mapping[str, str | None], force: bool) -> dict[str, tuple[int, int]]:
    """Find files of the user with names to be written; raises OutputError for the first unless with `force`."""
    found = {}
    for name in results.all_names:
        if name in mine or not os.path.lexists(path / name):
            continue
        state = os.lstat(path / name)
        if S_ISDIR(state.st_mode):
            raise IsADirectoryError(EISDIR, "a folder where a file is to be written", str(path / name))
        if not force:
            what = "not written by this program, or changed since" if S_ISREG(state.st_mode) else "not a regular file"
            hint = f"--resume goes on from there, {OTHERWISE}" if UNFINISHED_WORK.fullmatch(name) else OTHERWISE
            raise OutputError(f"{path / name}: {what}; {hint}")
        found[name] = (state.st_ino, state.st_mtime_ns)
    return found


def _make(directory: Path) -> None:
    """Make a directory; raises OSError that names an obstacle, OutputError for the sign of a home directory."""
    if directory.parts[:1] == ("~",):
        raise OutputError(f"{directory}: found a '~' that the shell has not replaced; the home's own path is expected")
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        found = "a link to nowhere" if Path(error.filename).is_symlink() else "a file"
        raise NotADirectoryError(ENOTDIR, f"{found} where a folder is to be written", error.filename) from None


def _check_folders(path: Path, names: Iterable[str]) -> None:
    """Raise an error if a folder for files is a link, a file or read-only."""
    for name in dict.fromkeys(name.partition("/")[0] for name in names if "/" in name):
        folder = path / name
        if folder.is_symlink():
            raise OutputError(f"{folder}: a link where a folder is to be written; --out writes elsewhere")
        if folder.exists() and not folder.is_dir():
            raise NotADirectoryError(ENOTDIR, "a file where a folder is to be written", str(folder))
        if folder.is_dir() and not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(EACCES, os.strerror(EACCES), str(folder))


def _check_readable(directory: Path) -> None:
    """Raise OutputError if something with a name that this program writes is not a regular file: reading a FIFO never
    ends.
    """
    for folder, prefix in [(directory, "")] + [(directory / name, f"{name}/") for name in ("tables", "figures")]:
        for entry in os.scandir(folder) if folder.is_dir() else ():
            if WRITTEN.fullmatch(prefix + entry.name) and not entry.is_file() and not entry.is_dir():
                raise OutputError(f"{entry.path}: not a regular file; results are expected")


# ---------------------------------------------------------------- whose a file is


def _is_mine(path: Path, name: str, files: Mapping[str, str | None]) -> bool:
    """Return whether a file is listed and unchanged."""
    if name not in files or not _may_be_removed(path, name):
        return False
    return files[name] is None or files[name] == _identity(path / name)


def _may_be_removed(path: Path, name: str) -> bool:
    """Return whether this is a regular file with a name that this program writes, not reached through a link."""
    folder = name.rpartition("/")[0]
    through_link = folder and (path / folder).is_symlink()
    return bool(WRITTEN.fullmatch(name)) and not through_link and is_regular(path / name)


def _is_written(place: OutputDirectory, name: str) -> bool:
    """Return whether a file exists and is not an unreplaced file of the user."""
    if not is_regular(place.path / name):
        return False
    state = os.lstat(place.path / name)
    return place.others.get(name) != (state.st_ino, state.st_mtime_ns)


def _identity(path: Path) -> str:
    """Identify the content of a file: by SHA-256, or for large time-streams by size and modification time."""
    if path.parent.name in ("timestreams", WEIGHTS):
        state = path.stat()
        return f"{state.st_size} bytes, {state.st_mtime_ns} ns"
    with open(path, "rb") as file:
        return file_digest(file, "sha256").hexdigest()
