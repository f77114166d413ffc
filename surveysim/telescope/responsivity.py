"""Responsivities of the detectors: the true ones, and those that cleaning assumes."""

import numpy as np

from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.analysis import Cleaning
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera


def camera_responsivity(scene: Scene, cam: Camera) -> np.ndarray:
    """True responsivity (n_det,) of the mapped band: that of the table of detectors, or a random one."""
    if cam.properties.responsivity is not None:
        return cam.properties.responsivity
    return true_responsivity(scene, len(cam.focal_plane.x_rad))


def true_responsivity(scene: Scene, n_det: int) -> np.ndarray:
    """Draw the true responsivity (n_det,) of the detectors, independently in each band of a camera."""
    rng = generator(scene.seed, RandomPurpose.RESPONSIVITY, band=scene.band_name)
    # Log-normal, so that a large scatter never turns a detector's sign; relative, so that their mean is 1.
    responsivity = np.exp(scene.instrument.responsivity_scatter * rng.standard_normal(n_det))
    return responsivity / responsivity.mean()


def assumed_responsivity(section: Cleaning, scene: Scene, true: np.ndarray) -> np.ndarray | None:
    """Draw the responsivities (n_det,) that a cleaning assumes in one band; None where it fits them."""
    if section.responsivities == "known":
        return true
    if section.responsivities != "survey":
        return None
    rng = generator(scene.seed, RandomPurpose.CALIBRATION, band=scene.band_name)
    error = rng.standard_normal(len(true))
    assumed = true * np.exp(section.calibration_error * error)  # log-normal, as the responsivities are
    return assumed / assumed.mean()
