"""Detectors that have readout noise or gaps in common: each alone, those of a readout group, or all."""

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


def check_groups(scene: Scene, camera: Camera) -> None:
    """Raise SceneError for readout groups that neither a key nor the table of detectors states."""
    sections: dict[str, Shared | GroupRedNoise] = {
        f"lines[{number}]": line for number, line in enumerate(scene.lines) if line.shared == "group"
    }
    if scene.readout_noise and scene.readout_noise.group:
        sections["readout_noise.group"] = scene.readout_noise.group
    if scene.dropped_samples and scene.dropped_samples.shared == "group":
        sections["dropped_samples"] = scene.dropped_samples
    for name, section in sections.items():
        if section.group_size is None and camera.properties.readout_group is None:
            raise SceneError(
                f"{name}.group_size: missing; it, or a column 'readout_group' of the table instrument.positions, is"
                " expected"
            )
