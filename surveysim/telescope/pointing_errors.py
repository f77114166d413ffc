"""Pointing errors: the boresight and the positions of detectors with which the sky is seen, about the assumed ones."""

from dataclasses import replace

import numpy as np

from mapmaker.timestreams import FocalPlane
from surveysim.runtime.rng import normal_deviates
from surveysim.scene.response import PointingErrors
from surveysim.scene.scene import Scene
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.smooth_process import smooth_process

_PURPOSE = "pointing_errors"
_DRIFT, _JITTER = 0, 1  # realizations of the random numbers of an observation


def true_focal_plane(scene: Scene, plane: FocalPlane) -> FocalPlane:
    """Return the focal plane with the true positions of the detectors: `plane` itself without errors."""
    section = scene.pointing_errors
    if section is None or not section.positions_rad:
        return plane
    deviates = normal_deviates(scene.seed, f"{_PURPOSE}.positions", band=scene.band_name)
    x, y = section.positions_rad * deviates.draw((2, len(plane.x_rad)), dtype=np.float64)
    return replace(plane, x_rad=plane.x_rad + x, y_rad=plane.y_rad + y)


def true_pointing(scene: Scene, observation: int, assumed: Pointing) -> Pointing:
    """Return the true pointing of a whole observation: `assumed` itself without errors.

    All bands of a camera have the same errors.
    """
    section = scene.pointing_errors
    if section is None or not (section.jitter_rad or section.drift_rad):
        return assumed
    xi, eta = _drift(section, scene.seed, observation, assumed.time_s) + _jitter(
        section, scene.seed, observation, assumed.time_s
    )
    return replace(assumed, xi_rad=assumed.xi_rad + xi, eta_rad=assumed.eta_rad + eta)


def _drift(section: PointingErrors, seed: int, observation: int, time_s: np.ndarray) -> np.ndarray:
    """Slow drift (2, n_samp) [rad] along xi and eta."""
    if not section.drift_rad:
        return np.zeros((2, 1))
    deviates = normal_deviates(seed, _PURPOSE, observation, realization=_DRIFT)
    return section.drift_rad * smooth_process(2, time_s[-1], section.drift_time_scale_s, deviates).at(time_s)


def _jitter(section: PointingErrors, seed: int, observation: int, time_s: np.ndarray) -> np.ndarray:
    """Jitter (2, n_samp) [rad] along xi and eta: white, or of a bandwidth."""
    deviates = normal_deviates(seed, _PURPOSE, observation, realization=_JITTER)
    if not section.jitter_rad:
        return np.zeros((2, 1))
    if section.jitter_bandwidth_hz is None:
        return section.jitter_rad * deviates.draw((2, len(time_s)), dtype=np.float64)
    time_scale_s = 1 / (2 * np.pi * section.jitter_bandwidth_hz)
    return section.jitter_rad * smooth_process(2, time_s[-1], time_scale_s, deviates).at(time_s)


def smearing_variance(section: PointingErrors | None) -> float:
    """Variance [rad^2], along each axis, of the Gaussian by which pointing errors widen the beam of a survey's map.

    The amplitude that it leaves at the multipole l is exp(-l^2 v / 2).
    """
    if section is None:
        return 0.0
    return section.jitter_rad**2 + section.drift_rad**2 + section.positions_rad**2
