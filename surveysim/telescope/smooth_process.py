"""Stationary Gaussian processes in time that are smooth: slow drifts, and jitter of a limited bandwidth."""

from dataclasses import dataclass

import numpy as np

from surveysim.runtime.rng import NormalDeviates

_STEP = 1 / 8  # knots a time scale: straight lines between them lose 0.3 % of the variance
_APART = 8.0  # time scales after which the process may repeat itself: correlations of 1e-14


@dataclass(frozen=True, eq=False)
class SmoothProcess:
    """Realizations of a process with unit variance and the correlation exp(-t^2 / 2 T^2) at a lag t.

    Attributes
    ----------
    knots : (n, n_knot)
        Values at multiples of `step_s`; the process is straight between them.
    """

    knots: np.ndarray
    step_s: float

    def at(self, time_s: np.ndarray, rows: slice = slice(None)) -> np.ndarray:
        """Values (n, n_samp) of some realizations at times (n_samp,) since the start."""
        place = time_s / self.step_s
        before = np.clip(place.astype(int), 0, self.knots.shape[1] - 2)
        share, knots = place - before, self.knots[rows]
        return knots[:, before] * (1 - share) + knots[:, before + 1] * share


def smooth_process(n: int, duration_s: float, time_scale_s: float, deviates: NormalDeviates) -> SmoothProcess:
    """Draw `n` independent realizations over a duration.

    White noise is filtered in Fourier space, periodic in a time longer than the duration by `_APART` time scales. The
    realization k takes the same deviates for any `n` above it.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    step_s = time_scale_s * _STEP
    n_knot = int(np.ceil(duration_s / step_s)) + 2
    period = next_fast_len(n_knot + int(np.ceil(_APART / _STEP)), real=True)
    lag = np.minimum(np.arange(period), period - np.arange(period)) * _STEP
    power = np.maximum(rfft(np.exp(-(lag**2) / 2)).real, 0)
    white = deviates.draw((n, period), dtype=np.float64)
    return SmoothProcess(irfft(rfft(white, axis=-1) * np.sqrt(power), period, axis=-1)[:, :n_knot], step_s)
