"""Paths of tables that a scene names."""

import os
from pathlib import Path
from typing import Any

_Stamp = tuple[int, int, int]


class TablePath(type(Path())):  # type: ignore[misc]
    """Path of a table, with the state of its file: paths of a file before and after a change differ.

    So records of a scene that was loaded before the change, and what was computed from them, are not taken for those of
    the same scene loaded again.

    Attributes
    ----------
    stamp
        Inode, size and time of the last change [ns] of the file; None without a file.
    """

    stamp: _Stamp | None = None

    def __new__(cls, *parts: str | Path) -> "TablePath":
        """Look at the file now."""
        made: TablePath = super().__new__(cls, *parts)
        try:
            state = os.stat(made)
        except OSError:
            return made
        made.stamp = state.st_ino, state.st_size, state.st_mtime_ns
        return made

    def __eq__(self, other: object) -> bool:
        if isinstance(other, TablePath) and self.stamp != other.stamp:
            return False
        return bool(super().__eq__(other))

    def __hash__(self) -> int:
        return int(super().__hash__())

    def __reduce__(self) -> tuple[Any, ...]:
        return _restored, (os.fspath(self), self.stamp)


def _restored(path: str, stamp: _Stamp | None) -> TablePath:
    """Make a path with the state that another process has found."""
    made = TablePath(path)
    made.stamp = stamp
    return made
