"""Detectors that have readout noise, gaps or crosstalk in common: each alone, those of a readout group, or all."""

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.scene.readout import GroupRedNoise, Shared
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera


def common_streams(camera: Camera, shared: str, group_size: int | None = None) -> np.ndarray:
    """Number (n_det,) of the stream that each detector has in common with others.

    Parameters
    ----------
    shared
        "detector", "group" or "array".
    group_size
        Detectors of a group; None for the groups of the table of detectors.
    """
    number = np.arange(camera.n_det)
    if shared == "detector":
        return number
    if shared == "array":
        return np.zeros_like(number)
    if group_size is not None:
        return number // group_size
    return np.unique(camera.properties.readout_group, return_inverse=True)[1]


def readout_groups(camera: Camera, group_size: int | None) -> tuple[np.ndarray, ...]:
    """Return the detectors of each readout group, by their rows in the table or their numbers.

    All detectors are one group where neither a size nor the table states groups. Dead detectors are left out, so those
    on both sides of one follow each other.
    """
    stated = group_size is not None or camera.properties.readout_group is not None
    number = common_streams(camera, "group" if stated else "array", group_size)
    return tuple(np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1]))


def uses_table_groups(scene: Scene) -> bool:
    """Return whether a section of the scene needs the readout groups of the table of detectors."""
    sections = [*_sections_by_group(scene).values(), *([scene.crosstalk] if scene.crosstalk else [])]
    return any(section.group_size is None for section in sections)


def _sections_by_group(scene: Scene) -> dict[str, Shared | GroupRedNoise]:
    """Sections, by name, of what the detectors of a readout group share."""
    sections: dict[str, Shared | GroupRedNoise] = {
        f"lines.{number}": line for number, line in enumerate(scene.lines) if line.shared == "group"
    }
    if scene.readout_noise and scene.readout_noise.group:
        sections["readout_noise.group"] = scene.readout_noise.group
    if scene.dropped_samples and scene.dropped_samples.shared == "group":
        sections["dropped_samples"] = scene.dropped_samples
    return sections


def check_groups(scene: Scene, camera: Camera) -> None:
    """Raise SceneError for readout groups that neither a key nor the table of detectors states."""
    for name, section in _sections_by_group(scene).items():
        if section.group_size is None and camera.properties.readout_group is None:
            raise SceneError(
                f"{name}.group_size: missing; it, or a column 'readout_group' of the table instrument.positions, is"
                " expected"
            )
