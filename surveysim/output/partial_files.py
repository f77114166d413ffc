"""Partial files of processes that ended early, and their removal."""

import logging
import os
import re
from collections.abc import Collection, Iterable
from contextlib import suppress
from pathlib import Path

from surveysim.output.file_names import NEW, UNFINISHED_WORK, WRITTEN
from surveysim.output.lock import LOCK, OutputError, alive, locked
from surveysim.output.record import NOTHING, RECORD, is_regular, read_record

_PARTIAL = re.compile(r"(.+)\.(\d+)\.part")


def remove_partial_files(directory: Path, names: Iterable[str]) -> None:
    """Remove partial files of processes that no longer exist, by the exact `names` of a command's files.

    In directories of the points of a sweep too, with the locks of their writers.
    """
    _remove_own(directory, names)
    for folder in directory.glob("points/*"):
        if folder.is_dir() and not folder.is_symlink() and not folder.parent.is_symlink() and _is_left(folder):
            with suppress(OutputError), locked(folder, level=logging.DEBUG):  # its writer may be at work
                _remove_own(folder, ())


def _is_left(folder: Path) -> bool:
    """Return whether a folder has a lock, or something with the name of a partial file."""
    return any(entry.name == LOCK or _PARTIAL.fullmatch(entry.name) for entry in os.scandir(folder))


def _remove_own(directory: Path, names: Iterable[str]) -> None:
    _remove_folders(directory)
    listed: Collection[str] = (read_record(directory) or NOTHING)["files"]
    known = {*listed, *names, RECORD}
    folders = {name.rpartition("/")[0] for name in known if WRITTEN.fullmatch(name)}
    for folder in folders | {"", "timestreams", "points"}:
        where = directory / folder
        for entry in os.scandir(where) if where.is_dir() and not where.is_symlink() else ():
            match = _PARTIAL.fullmatch(entry.name)
            if match is None or not entry.is_file(follow_symlinks=False):
                continue
            name = f"{folder}/{match[1]}".lstrip("/")
            own = name in known or UNFINISHED_WORK.fullmatch(name) or name.startswith(f"{LOCK}.")
            if own and _is_over(int(match[2])):
                Path(entry.path).unlink(missing_ok=True)


def _remove_folders(path: Path) -> None:
    """Remove temporary folders of results, except for files that others have put there."""
    for entry in os.scandir(path):
        match = _PARTIAL.fullmatch(entry.name)
        if not match or match[1] != NEW or not entry.is_dir(follow_symlinks=False) or not _is_over(int(match[2])):
            continue
        for folder, _, names in os.walk(entry.path, topdown=False):
            for file in (Path(folder) / name for name in names):
                name = file.relative_to(entry.path).as_posix()
                half = _PARTIAL.fullmatch(name)
                if WRITTEN.fullmatch(half[1] if half else name) and is_regular(file):
                    file.unlink()
            with suppress(OSError):  # other files in it stay
                os.rmdir(folder)


def _is_over(pid: int) -> bool:
    return pid == os.getpid() or not alive(pid)  # this process writes nothing else here
