"""The astronomical sky in time-streams: bilinear look-ups along the tracks of the detectors."""

import numpy as np

from mapmaker.kernels.pixels import add_sky
from surveysim.runtime.errors import OutOfRangeError
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.simulation import Simulation


def add_scene_sky(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the sky of the scene to streams (n_det, n_samp) of a block, in place."""
    add_seen_sky(of.setup, of.pointing, of.setup.sky.map_mk, data_mk, np.ones(len(data_mk)))


def add_seen_sky(
    setup: Simulation, pointing: Pointing, sky_mk: np.ndarray, data_mk: np.ndarray, gain: np.ndarray
) -> None:
    """Add a sky (n_y, n_x), times the gain (n_det,) of each detector, to streams (n_det, n_samp), in place.

    Raises
    ------
    ValueError
        For streams or gains of other samples or detectors than those of the pointing and the camera.
    """
    grid, plane = setup.sky.geometry, setup.camera.focal_plane
    n_det, n_samp = len(plane.x_rad), len(pointing.xi_rad)
    if data_mk.shape != (n_det, n_samp) or gain.shape != (n_det,):
        raise OutOfRangeError(
            f"found streams {data_mk.shape}, gains {gain.shape}; ({n_det}, {n_samp}), ({n_det},) are expected"
        )
    scale = 1 / grid.pixel_rad
    angle = pointing.array_angle_rad[pointing.scan]
    column = grid.n_x / 2 - 0.5 - pointing.xi_rad * scale
    row = grid.n_y / 2 - 0.5 + pointing.eta_rad * scale
    cos, sin = np.cos(angle) * scale, np.sin(angle) * scale
    add_sky(data_mk, sky_mk, column, row, cos, sin, plane.x_rad, plane.y_rad, gain.astype(data_mk.dtype))
