"""Time constants of the detectors: a low-pass filter of one pole on all that they see, scan by scan."""

import numpy as np

from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.simulation import Simulation


def apply_time_constants(setup: Simulation, seen_mk: np.ndarray) -> None:
    """Filter optical signals (n_det, n_samp) with the time constants of the detectors, in place.

    At the start of a scan a detector is at rest at the first sample; after three time constants 5 % of the difference
    from a moving start are left. Nothing changes without time constants.
    """
    tau = setup.camera.properties.time_constant_s
    if tau is None:
        return
    from surveysim.timestreams.response_kernels import low_pass

    scans = setup.observing.scans
    low_pass(seen_mk, samples_per_scan(scans), *pole_coefficients(tau, scans.sample_rate_hz))


def with_time_constants(setup: Simulation, seen_mk: np.ndarray) -> np.ndarray:
    """Filtered copy of optical signals (n_det, n_samp); the signals themselves without time constants."""
    if setup.camera.properties.time_constant_s is None:
        return seen_mk
    passed = seen_mk.copy()
    apply_time_constants(setup, passed)
    return passed


def pole_coefficients(time_constant_s: np.ndarray, sample_rate_hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (n_det,) of `low_pass`: exact for a signal that is linear between samples.

    With E = exp(-1 / (rate tau)) and m = rate tau (1 - E), the mean of the response over a sampling interval:
    E, 1 - m and m - E. A time constant of 0 changes nothing.
    """
    samples = np.asarray(time_constant_s, dtype=float) * sample_rate_hz
    with np.errstate(divide="ignore"):
        decay = np.exp(-1 / samples)
    mean = samples * -np.expm1(np.divide(-1.0, samples, out=np.full(len(samples), -np.inf), where=samples > 0))
    return decay, 1 - mean, mean - decay
