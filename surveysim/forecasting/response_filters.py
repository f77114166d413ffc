"""Closed forms of the response: filters of time constants, their deconvolution, and gains that differ or drift."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.forecasting.observing_conditions import ObservingConditions
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.setup import Setup
from surveysim.telescope.scans import duration_s
from surveysim.timestreams.responsivity import load_losses
from surveysim.timestreams.time_constants import derivative_response, pole_response

# Steps of the response that forecasts have in closed form; a scene with another one can't be forecast.
CLOSED_STEPS = ("pointing_errors", "responsivity", "responsivity_drift", "time_constants", "crosstalk", "deconvolution")
Origin = Literal["light", "output"]  # of noise: seen by the detectors, or added at their output


@dataclass(frozen=True, eq=False)
class StreamFilters:
    """Filters of the streams of a pipeline's detectors: time constants, and their deconvolution.

    Attributes
    ----------
    time_constant_s : (n_det,)
    deconvolved_s : (n_det,)
        0 without deconvolution.
    """

    time_constant_s: np.ndarray
    deconvolved_s: np.ndarray
    sample_rate_hz: float

    def signal(self, frequency_hz: np.ndarray) -> np.ndarray:
        """Amplitude (n_det, n_f) that is left of waves: the real part, which scans of both directions leave."""
        return self._response(frequency_hz, slice(None), "light").real

    def power(self, frequency_hz: np.ndarray, origin: Origin) -> np.ndarray:
        """Power (n_f,) that is left of noise, as a mean over the detectors."""
        total, n_det = np.zeros(len(frequency_hz)), len(self.time_constant_s)
        for rows in row_chunks(n_det, len(frequency_hz)):
            total += np.sum(np.abs(self._response(frequency_hz, rows, origin)) ** 2, axis=0)
        return total / n_det

    def _response(self, frequency_hz: np.ndarray, rows: slice, origin: Origin) -> np.ndarray:
        lead = self.deconvolved_s[rows, None] * derivative_response(frequency_hz, self.sample_rate_hz)
        if origin == "output":
            return 1 + 1j * lead
        return (1 + 1j * lead) * pole_response(self.time_constant_s[rows], frequency_hz, self.sample_rate_hz)


def stream_filters(setup: Setup, pipeline: CleaningPipeline) -> StreamFilters | None:
    """Filters of a pipeline's detectors; None without time constants."""
    camera = setup.camera
    if camera.time_constant_s is None:
        return None
    deconvolved = np.zeros(camera.n_det) if camera.deconvolved_s is None else camera.deconvolved_s
    rate = setup.observing.scans.sample_rate_hz
    return StreamFilters(camera.time_constant_s[pipeline.rows], deconvolved[pipeline.rows], rate)


def gain_variance(setup: Setup, pipeline: CleaningPipeline, conditions: ObservingConditions) -> float:
    """Variance of the relative gains of the detectors in a scan about those that cleaning assumes or fits.

    They are independent between detectors, and leak their part of the common layer. Fits to scans, or to whole
    observations, leave the part of the drift within these. Fits are taken to follow the loss by the load.
    """
    section, scans = setup.scene.responsivity_drift, setup.observing.scans
    if section is None:
        return 0.0
    fitted = {"scan": scans.scan_s, "observation": duration_s(scans)}
    seconds = fitted.get(setup.scene.cleaning.responsivities) if pipeline.takes_responsivities else None
    seconds = scans.scan_s if pipeline.uses("pca") else seconds
    drift = float(np.expm1(section.rms**2))
    if seconds is not None:
        return drift * drift_left(section.time_scale_s, seconds) if drift else 0.0
    losses = load_losses(setup.scene, setup.camera.n_det)
    return drift + float(losses.var() * np.mean(conditions.load_k**2))


def drift_left(time_scale_s: float, seconds: float) -> float:
    """Mean variance of a drift of unit variance, with the correlation exp(-t^2 / 2 T^2), about its mean over a time."""
    node, weight = np.polynomial.legendre.leggauss(64)
    lag = (node + 1) / 2
    return float(1 - weight @ ((1 - lag) * np.exp(-((lag * seconds / time_scale_s) ** 2) / 2)))
