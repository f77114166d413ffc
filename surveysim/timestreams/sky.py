"""The astronomical sky in time-streams: bilinear look-ups along the tracks of the detectors."""

import numpy as np

from mapmaker.geometry import pixel_homography
from mapmaker.timestreams import FocalPlane
from surveysim.runtime.errors import OutOfRangeError
from surveysim.telescope.pointing import Pointing
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.simulation import Simulation


def add_scene_sky(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the sky of the scene to streams (n_det, n_samp) of a block, in place."""
    add_true_sky(of, of.setup.sky.map_mk, data_mk, np.ones(len(data_mk)))


def add_true_sky(of: ObservedBlock, sky_mk: np.ndarray, data_mk: np.ndarray, gain: np.ndarray) -> None:
    """Add a sky at the true pointing of a block; parameters and errors as for `add_seen_sky`."""
    add_seen_sky(of.setup, of.true_pointing, sky_mk, data_mk, gain, plane=of.setup.camera.true_plane)


def add_seen_sky(
    setup: Simulation,
    pointing: Pointing,
    sky_mk: np.ndarray,
    data_mk: np.ndarray,
    gain: np.ndarray,
    *,
    plane: FocalPlane | None = None,
) -> None:
    """Add a sky, times the gain (n_det,) of each detector, to streams (n_det, n_samp), in place.

    Several skies (n_sky, ...) are added to as many streams (n_sky, n_det, n_samp).

    Parameters
    ----------
    plane
        Positions of the detectors; by default those that are assumed.
    sky_mk : (n_y, n_x) or (n_beam, n_y, n_x)
        The sky, or the sky through each of the camera's beams.

    Raises
    ------
    ValueError
        For streams or gains of other samples or detectors than those of the pointing and the camera.
    """
    from mapmaker.kernels.pixels import add_skies

    grid, plane = setup.sky.geometry, plane or setup.camera.focal_plane
    n_det, n_samp = len(plane.x_rad), len(pointing.xi_rad)
    if data_mk.shape[-2:] != (n_det, n_samp) or gain.shape != (n_det,):
        raise OutOfRangeError(
            f"found streams {data_mk.shape}, gains {gain.shape}; ({n_det}, {n_samp}), ({n_det},) are expected"
        )
    track = pixel_homography(grid, pointing.xi_rad, pointing.eta_rad, pointing.array_angle_rad, first=-0.5)
    gain = gain.astype(data_mk.dtype)
    streams = data_mk if data_mk.ndim == 3 else data_mk[None]
    skies = sky_mk.reshape(len(streams), -1, grid.n_y, grid.n_x)
    if skies.shape[1] == 1:
        add_skies(streams, skies[:, 0], track, plane.x_rad, plane.y_rad, gain)
        return
    for number in range(skies.shape[1]):
        rows = np.flatnonzero(setup.camera.beams.of_detector == number)
        part, through = streams[:, rows], np.ascontiguousarray(skies[:, number])
        add_skies(part, through, track, plane.x_rad[rows], plane.y_rad[rows], gain[rows])
        streams[:, rows] = part
