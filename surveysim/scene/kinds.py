"""Kinds of scene files: of one band or of several, with a sweep or without. The keys are not checked."""

from pathlib import Path

from surveysim.scene.scene import read_scene
from surveysim.scene.shipped import find_scene


def has_bands(path: str | Path) -> bool:
    """Return whether a scene file has tables [bands.NAME]; raises SceneError if it cannot be read."""
    return "bands" in read_scene(find_scene(path))[1]


def is_sweep(path: str | Path) -> bool:
    """Return whether a scene file has a table [sweep]; raises SceneError if it cannot be read."""
    return "sweep" in read_scene(find_scene(path))[1]
