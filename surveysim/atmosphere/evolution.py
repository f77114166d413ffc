"""Evolution of a layer beside its motion: independent realizations that are mixed in time.

With a decorrelation time T a layer is, in the frame that moves with it,

    L(r, t) = sum over k of w(t / T + phase - k) A_k(r),    w(x) = cos(pi x / 2) for |x| < 1, else 0,

with independent realizations A_k. Two of them have a weight at any time, one fading and one growing, whose squares add
to one, so the spatial statistics are those of A_k at all times. With a phase that is uniform over observations the
correlation in time of any Fourier mode of the layer, in the frame that moves with it, is

    rho(t) = (1 - t / 2 T) cos(pi t / 2 T) + sin(pi t / 2 T) / pi    for t < 2 T, else 0.

It begins as 1 - pi^2 t^2 / 8 T^2, so the layer is smooth in time. All scales decorrelate in one time; real eddies live
longer the larger they are.

Realizations have a mean of 0 over the rectangle of each scan: the mean of a layer without an outer scale has no finite
variance, and all that its changes add is a slow signal that detectors share. So the covariance of two samples of one
scan is that of the frozen layer, relative to the mean over the rectangle, times the correlation.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor

import numpy as np


def evolution_correlation(lag_s: float | np.ndarray, decorrelation_s: float) -> np.ndarray:
    """Correlation in time of a layer, in the frame that moves with it, mean over the phase."""
    lag = np.minimum(np.abs(lag_s) / decorrelation_s, 2.0)
    return (1.0 - lag / 2.0) * np.cos(np.pi * lag / 2.0) + np.sin(np.pi * lag / 2.0) / np.pi


@dataclass(frozen=True)
class Evolution:
    """Realizations of a layer over an observation.

    Attributes
    ----------
    decorrelation_s
    phase
        From 0 to 1.
    """

    decorrelation_s: float
    phase: float

    def weight(self, number: int, time_s: np.ndarray) -> np.ndarray:
        """Weights of the realization with a number at some times since the start of the observation."""
        place = time_s / self.decorrelation_s + self.phase - number
        return np.where(np.abs(place) < 1.0, np.cos(0.5 * np.pi * place), 0.0)

    def realizations(self, start_s: np.ndarray, end_s: np.ndarray) -> Iterator[tuple[int, int, int]]:
        """Yield the number of each realization, and its first and one-past-last scan.

        Parameters
        ----------
        start_s, end_s : (n_scan,)
            Times of the first and the last sample of each scan, in increasing order.
        """
        start, end = (time_s / self.decorrelation_s + self.phase for time_s in (start_s, end_s))
        for number in range(floor(start[0]), ceil(end[-1]) + 1):
            seen = np.flatnonzero((end > number - 1.0) & (start < number + 1.0))
            if len(seen):
                yield number, int(seen[0]), int(seen[-1]) + 1
