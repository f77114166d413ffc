"""Time constants of the detectors: the true ones, and those with which streams are deconvolved."""

import numpy as np

from surveysim.runtime.errors import SceneError
from surveysim.runtime.rng import generator
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera

_PURPOSE = "time_constants"
_TRUE, _ASSUMED = 0, 1  # realizations of the random numbers


def true_time_constants(scene: Scene, cam: Camera) -> np.ndarray | None:
    """True time constants (n_det,) [s] of the mapped band: of the table of detectors or [time_constants].

    None where detectors have none.

    Raises
    ------
    SceneError
        For time constants that are stated twice or not at all, or longer than a tenth of a scan.
    """
    section, of_table = scene.time_constants, cam.properties.time_constant_s
    if section is None:
        return of_table
    if (section.value_s is None) == (of_table is None):
        found = "missing" if of_table is None else "found together with the column 'time_constant' of the table"
        raise SceneError(
            f"time_constants.value: {found}; one of 'value' and a column 'time_constant' of the table"
            " instrument.positions is expected"
        )
    tau_s = of_table
    if section.value_s is not None:
        tau_s = section.value_s * _log_normal(scene, _TRUE, section.scatter, cam.n_det)
    if not (longest := tau_s.max()) <= scene.scan.duration_s / 10:
        raise SceneError(
            f"time_constants.value: found a detector of {longest:.4g} s; {scene.scan.duration_s / 10:g} s or less is"
            f" expected, a tenth of {scene.scan.duration_key}"
        )
    return tau_s


def assumed_time_constants(scene: Scene, true_s: np.ndarray | None) -> np.ndarray | None:
    """Time constants (n_det,) [s] with which streams are deconvolved; None where they are not."""
    section = scene.time_constants
    if section is None or section.deconvolution_error is None:
        return None
    return true_s * _log_normal(scene, _ASSUMED, section.deconvolution_error, len(true_s))


def _log_normal(scene: Scene, realization: int, scatter: float, n_det: int) -> np.ndarray:
    """Draw factors (n_det,) with a median of 1 and a scatter in the logarithm."""
    rng = generator(scene.seed, _PURPOSE, realization=realization, band=scene.band_name)
    return np.exp(scatter * rng.standard_normal(n_det))
