"""Order of the detectors in readout: groups, and neighbours in each."""

import numpy as np

from surveysim.scene.response import Crosstalk
from surveysim.telescope.focal_plane import Camera


def readout_groups(section: Crosstalk, cam: Camera) -> tuple[np.ndarray, ...]:
    """Return the detectors of each readout group, in the order of readout.

    Detectors of a group are in the order of the rows of the table, or of their numbers. Dead ones are left out, so the
    detectors on both sides of a dead one are neighbours.
    """
    number = np.arange(cam.n_det)
    if section.group_size is not None:
        return tuple(np.split(number, np.arange(section.group_size, cam.n_det, section.group_size)))
    names = cam.properties.readout_group
    if names is None:
        return (number,)
    return tuple(np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist()))
