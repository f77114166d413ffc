"""Refusals of scenes and of files: errors in short lines that name the file, and leave it as it is."""

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import pytest

from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene

SECONDS = 5.0  # of a machine that has other work
LONGEST_LINE, MOST_LINES = 400, 31


def scene_refusal(path: Path, overrides: dict[str, Any] | None = None) -> str:
    """The immediate refusal of a scene, less its path, in few and short lines."""
    start = perf_counter()
    with pytest.raises(SceneError) as caught:
        load_scene(path, overrides)
    assert perf_counter() - start < SECONDS
    assert not isinstance(caught.value.__cause__, Exception)
    lines = str(caught.value).splitlines()
    assert 0 < len(lines) <= MOST_LINES and all(line.startswith(f"{path}: ") and line.isprintable() for line in lines)
    assert all(len(line) - len(str(path)) < LONGEST_LINE for line in lines)
    return "\n".join(line.removeprefix(f"{path}: ") for line in lines)


def refused(read: Callable[[Path], object], path: Path, words: str) -> None:
    """Check that a reader refuses a file with some words (a pattern) in one line that begins with its path."""
    before = path.read_bytes() if path.is_file() else None
    with pytest.raises(ValueError, match=words) as caught:
        read(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and len(text) < len(str(path)) + 300
    assert before is None or path.read_bytes() == before
