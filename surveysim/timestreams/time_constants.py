"""Time constants of the detectors: a low-pass filter of one pole on all that they see, and its inverse, by scan."""

from collections.abc import Callable
from functools import partial

import numpy as np

from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.simulation import Simulation

_REACH = 2  # samples on both sides that a derivative takes


def time_constants(of: ObservedBlock, seen_mk: np.ndarray) -> Callable[[np.ndarray], None]:
    """Filter what detectors see with their time constants."""
    return partial(apply_time_constants, of.setup)


def apply_time_constants(setup: Simulation, seen_mk: np.ndarray) -> None:
    """Filter optical signals (n_det, n_samp) with the time constants of the detectors, in place.

    At the start of a scan a detector is at rest at the first sample; after three time constants 5 % of the difference
    from a moving start are left. Nothing changes without time constants.
    """
    tau = setup.camera.time_constant_s
    if tau is None:
        return
    from surveysim.timestreams.response_kernels import low_pass

    scans = setup.observing.scans
    low_pass(seen_mk, samples_per_scan(scans), *pole_coefficients(tau, scans.sample_rate_hz))


def deconvolution(of: ObservedBlock, seen_mk: np.ndarray) -> Callable[[np.ndarray], None]:
    """Add the assumed time constant times the derivative of each stream: the inverse of one pole.

    Derivatives are those of quartics through five samples. At a tenth of the sample rate they are 0.5 % too small, and
    0 at half of it, so that white noise rises by ``1 + (2 pi f tau)^2`` at low frequencies alone.
    """
    from surveysim.timestreams.response_kernels import add_derivative

    scans = of.setup.observing.scans
    lead = of.setup.camera.deconvolved_s * scans.sample_rate_hz
    return lambda data_mk: add_derivative(data_mk, samples_per_scan(scans), lead)


def widen_flags(setup: Simulation, lost: np.ndarray) -> None:
    """Flag the samples (n_det, n_samp) whose deconvolution takes lost samples of their scan, in place."""
    if setup.camera.deconvolved_s is None:
        return
    scans = lost.reshape(len(lost), -1, samples_per_scan(setup.observing.scans))
    stated = scans.copy()
    for places in range(1, _REACH + 1):
        scans[..., places:] |= stated[..., :-places]
        scans[..., :-places] |= stated[..., places:]


def derivative_response(frequency_hz: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """Derivative [1/s] of unit waves at some frequencies as `deconvolution` takes it, over the imaginary unit."""
    turn = 2 * np.pi * frequency_hz / sample_rate_hz
    return sample_rate_hz * (8 * np.sin(turn) - np.sin(2 * turn)) / 6


def pole_coefficients(time_constant_s: np.ndarray, sample_rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (n_det,) and (n_det, 4) of `low_pass`: exact for a signal that is cubic between samples.

    The response to a wave is that of a pole within 0.3 % in amplitude up to a tenth of the sample rate, within 3 % up
    to a fifth. A time constant of 0 changes nothing.
    """
    samples = np.asarray(time_constant_s, dtype=float) * sample_rate_hz
    with np.errstate(divide="ignore"):
        decay = np.exp(-1 / samples)
    return decay, _moments(samples, decay) @ _LAGRANGE.T


def pole_response(time_constant_s: np.ndarray, frequency_hz: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """Complex response (n_det, n_f) of `low_pass` to waves: that of a pole, but near half of the sample rate."""
    decay, taps = pole_coefficients(time_constant_s, sample_rate_hz)
    wave = np.exp(2j * np.pi * frequency_hz / sample_rate_hz)
    passed: np.ndarray = taps @ wave ** np.arange(-2, 2)[:, None] / (1 - decay[:, None] / wave)
    return passed


def _moments(samples: np.ndarray, decay: np.ndarray) -> np.ndarray:
    """Moments (n_det, 4) of order 0 to 3 of the impulse response over the last sampling interval.

    Their recursion is unstable for long time constants, where quadrature is exact.
    """
    moments = np.empty((len(samples), 4))
    moments[:, 0] = 1 - decay
    for order in range(1, 4):
        moments[:, order] = 1 - order * samples * moments[:, order - 1]
    node, weight = np.polynomial.legendre.leggauss(16)
    time, long = (1 + node) / 2, samples > 1
    pulse = np.exp((time - 1) / samples[long, None]) / samples[long, None] * (weight / 2)
    moments[long] = pulse @ time[:, None] ** np.arange(4)
    return moments


# Coefficients (4, 4), by rising power of time, of the cubics that are 1 at one of the times -1, 0, 1, 2, else 0.
_LAGRANGE = np.linalg.inv(np.vander([-1.0, 0.0, 1.0, 2.0], increasing=True)).T
