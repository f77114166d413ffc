"""Responsivities of the detectors: the true ones, and those that cleaning assumes."""

import numpy as np

from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera


def camera_responsivity(scene: Scene, cam: Camera) -> np.ndarray:
    """True responsivity (n_det,) of the mapped band: that of the table of detectors, or a random one."""
    if cam.properties.responsivity is not None:
        return cam.properties.responsivity
    return true_responsivity(scene, len(cam.focal_plane.x_rad))


def band_responsivity(scene: Scene, n_det: int) -> np.ndarray:
    """Draw the responsivity (n_band, n_det) of the detectors of the other bands, independently in each."""
    bands = range(1, len(scene.instrument.bands) + 1)
    return np.array([true_responsivity(scene, n_det, band) for band in bands]).reshape(len(bands), n_det)


def true_responsivity(scene: Scene, n_det: int, realization: int = 0) -> np.ndarray:
    """Draw the true responsivity (n_det,) of the mapped band, or of another band by its `realization`."""
    scatter = generator(scene.seed, RandomPurpose.RESPONSIVITY, realization=realization).standard_normal(n_det)
    # Log-normal, so that a large scatter never turns a detector's sign; relative, so that their mean is 1.
    responsivity = np.exp(scene.instrument.responsivity_scatter * scatter)
    return responsivity / responsivity.mean()


def assumed_responsivity(scene: Scene, true: np.ndarray) -> np.ndarray | None:
    """Draw the responsivities (n_band, n_det) that cleaning assumes; None where cleaning fits them."""
    section = scene.cleaning
    if section.responsivities == "known":
        return true
    if section.responsivities != "survey":
        return None
    rngs = (generator(scene.seed, RandomPurpose.CALIBRATION, realization=band) for band in range(len(true)))
    error = np.array([rng.standard_normal(true.shape[1]) for rng in rngs])
    assumed = true * np.exp(section.calibration_error * error)  # log-normal, as the responsivities are
    return assumed / assumed.mean(axis=1, keepdims=True)
