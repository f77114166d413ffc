"""Responsivities of the detectors in time-streams: constant ones, their drift, and their loss by the optical load."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.runtime.errors import SceneError
from surveysim.runtime.rng import generator, normal_deviates
from surveysim.scene.response import ResponsivityDrift
from surveysim.scene.scene import Scene
from surveysim.telescope.optics import site_load_k
from surveysim.telescope.smooth_process import SmoothProcess, smooth_process
from surveysim.timestreams.observed_block import ObservedBlock

MOST_LOSS = 0.5  # largest relative change of a responsivity by the load
_PURPOSE = "responsivity_drift"


def responsivities(of: ObservedBlock, seen_mk: np.ndarray) -> Callable[[np.ndarray], None]:
    """Multiply each stream by the responsivity of its detector."""
    gain = of.setup.camera.responsivity[:, None]

    def multiply(data_mk: np.ndarray) -> None:
        data_mk *= gain.astype(data_mk.dtype)

    return multiply


@dataclass(frozen=True, eq=False)
class _Drift:
    """Responsivities of one block, relative to those of the camera.

    Attributes
    ----------
    process
        Drift of unit variance; None without it.
    loss_k : (n_det,)
        Loss for each K of load.
    load_k : (n_samp,)
        Additional load.
    """

    section: ResponsivityDrift
    process: SmoothProcess | None
    time_s: np.ndarray
    loss_k: np.ndarray
    load_k: np.ndarray

    def __call__(self, data_mk: np.ndarray) -> None:
        for rows in row_chunks(*data_mk.shape):
            data_mk[rows] *= self.gain(rows).astype(data_mk.dtype)

    def gain(self, rows: slice = slice(None)) -> np.ndarray:
        """Relative responsivities (n, n_samp) of some detectors."""
        loss = 1 - self.loss_k[rows, None] * self.load_k
        if self.process is None:
            return loss
        rms = self.section.rms  # log-normal, with a mean of 1
        return loss * np.exp(rms * self.process.at(self.time_s, rows) - rms**2 / 2)


def responsivity_drift(of: ObservedBlock, seen_mk: np.ndarray) -> _Drift:
    """Multiply streams by the drift of each detector and by its loss at the load of the array."""
    scene, section = of.setup.scene, of.setup.scene.responsivity_drift
    n_det, process = of.setup.camera.n_det, None
    if section.rms:
        deviates = normal_deviates(scene.seed, _PURPOSE, of.observation, band=scene.band_name)
        process = smooth_process(n_det, of.whole.time_s[-1], section.time_scale_s, deviates)
    loss_k, load_k = load_losses(scene, n_det), array_load_k(of, seen_mk)
    _check_loss(of.observation, loss_k, load_k)
    return _Drift(section, process, of.pointing.time_s, loss_k, load_k)


def _check_loss(observation: int, loss_k: np.ndarray, load_k: np.ndarray) -> None:
    """Raise SceneError for a load that takes most of a responsivity."""
    largest = np.abs(loss_k).max() * np.abs(load_k).max()
    if not largest <= MOST_LOSS:
        raise SceneError(
            f"responsivity_drift.load_coefficient: found a load in observation {observation} that differs by"
            f" {np.abs(load_k).max():.3g} K from that at calibration, which changes a responsivity by"
            f" {100 * largest:.0f} %; {100 * MOST_LOSS:.0f} % or less is expected"
        )


def load_losses(scene: Scene, n_det: int) -> np.ndarray:
    """Loss (n_det,) of responsivity for each K of load: log-normal, of one sign."""
    section = scene.responsivity_drift
    scatter = generator(scene.seed, f"{_PURPOSE}.load", band=scene.band_name).standard_normal(n_det)
    return section.load_coefficient_per_k * np.exp(section.load_scatter * scatter)


def array_load_k(of: ObservedBlock, seen_mk: np.ndarray) -> np.ndarray:
    """Load (n_samp,) [K] of the array beyond the load at calibration, by airmass and layer.

    The layer is the mean of the streams that the detectors see: it differs little across the array.
    """
    if not of.setup.scene.responsivity_drift.load_coefficient_per_k:
        return np.zeros(seen_mk.shape[1])
    return 1e-3 * seen_mk.mean(axis=0, dtype=float) + airmass_load_k(of)[of.pointing.scan]


def airmass_load_k(of: ObservedBlock) -> np.ndarray:
    """Load (n_scan,) [K] of the site's air in the scans of a block, beyond that at calibration; 0 without a site."""
    water, elevation_rad = of.setup.air.water, of.pointing.scan_elevation_rad
    if water is None:
        return np.zeros(len(elevation_rad))
    calibrated = of.setup.scene.responsivity_drift.calibration_elevation_rad
    at = of.whole.scan_elevation_rad if calibrated is None else np.array([calibrated])
    loads = [site_load_k(water.opacity, of.weather.pwv_mm, item) for item in (elevation_rad, at)]
    return loads[0] - loads[1].mean()
