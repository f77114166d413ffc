"""Record of an output directory: a hidden file that says which command wrote it, of which scene, and its files."""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from stat import S_ISREG
from typing import Any

from mapmaker.files import atomic_write
from surveysim import __version__

RECORD = ".surveysim.json"
NOTHING: dict[str, Any] = {"command": "", "scene": "", "sha256": "", "finished": True, "files": {}}


@dataclass(frozen=True)
class Results:
    """Results of a command: its identity, and the names of all files that it may write, relative to its directory.

    `sha256` is the hash of everything that the results depend on; `extends` is equal for runs that differ only in their
    number of observations, and empty for other commands. `inputs` are files, with their content, that are written
    before the work starts. The caller writes the results; it writes `piecewise` results directly to their places.
    """

    command: str
    scene: str
    sha256: str
    names: tuple[str, ...]
    inputs: Mapping[str, bytes] = field(default_factory=dict)
    piecewise: bool = False
    extends: str = ""

    @property
    def all_names(self) -> tuple[str, ...]:
        """Names of inputs and results."""
        return (*self.inputs, *self.names)


def is_regular(path: Path) -> bool:
    """Return whether a path leads to a regular file, and not by a link."""
    try:
        return S_ISREG(os.lstat(path).st_mode)
    except (OSError, ValueError):
        return False


def read_record(path: Path) -> dict[str, Any] | None:
    """Read the record of a directory; None without one that this program wrote."""
    if not is_regular(path / RECORD):
        return None
    try:
        found = json.loads((path / RECORD).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    types = {"surveysim": str, "command": str, "scene": str, "sha256": str, "finished": bool, "files": dict}
    whole = isinstance(found, dict) and all(isinstance(found.get(key), kind) for key, kind in types.items())
    whole = whole and all(isinstance(value, str | None) for value in found["files"].values())
    return found if whole else None


def write_record(
    path: Path, results: Results, files: Mapping[str, str | None], *, finished: bool, whole: bool = True
) -> None:
    """Write the record of a directory: its command, scene and files, and whether they are finished and whole."""
    content = {"surveysim": __version__, "command": results.command, "scene": results.scene, "sha256": results.sha256}
    content |= {"extends": results.extends}
    state = {"finished": finished, "whole": finished and whole}
    rewrite_record(path, content | state | {"files": dict(sorted(files.items()))})


def rewrite_record(path: Path, content: Mapping[str, Any]) -> None:
    """Write the content of a record."""
    with atomic_write(path / RECORD) as partial:
        partial.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
