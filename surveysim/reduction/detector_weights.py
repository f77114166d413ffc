"""Weights of detectors in maps: the inverse of their white noise."""

import numpy as np

from surveysim.telescope.beams import Beams
from surveysim.telescope.beams import beams_of as weighted_beams
from surveysim.telescope.noise_levels import WhiteLevels
from surveysim.timestreams.simulation import CameraSetup, camera_white


def detector_weights(camera: CameraSetup, levels: WhiteLevels) -> np.ndarray | None:
    """Weights (n_det,) of the samples of each detector in a map, with a mean of 1; None where all weigh alike.

    They are the inverse of the white noise of each detector, which a table states. They do not depend on the data, so
    they bias nothing; they are optimal for white noise.

    Parameters
    ----------
    levels
        White noise of a nominal detector.
    """
    if not camera.properties.white_differs:
        return None
    white = camera_white(camera, levels)
    total = white.shared + white.alone + white.detector
    return None if not total.all() else (1 / total) / np.mean(1 / total)


def weighted(data_mk: np.ndarray, weight: np.ndarray | None) -> np.ndarray:
    """Multiply streams (n_det, n_samp) by the weights (n_det,) of their detectors; the streams themselves without."""
    return data_mk if weight is None else data_mk * weight[:, None].astype(data_mk.dtype)


def beams_of(camera: CameraSetup, weight: np.ndarray | None) -> Beams:
    """Beams of a camera, with their weights in maps."""
    beams = camera.beams
    if weight is None:
        return beams
    return weighted_beams(beams.fwhm_rad[beams.of_detector], camera.responsivity * weight)
