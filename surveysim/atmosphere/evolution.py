"""Evolution of a layer beside its motion: independent realizations that are mixed in time.

With a decorrelation time T a layer is, in the frame that moves with it,

    L(r, t) = sum over k of s_k w(t / T + phase - k) A_k(r),    w(x) = cos(pi x / 2) for |x| < 1, else 0,

with realizations A_k and random signs s_k. Two of them have a weight at any time, one fading and one growing, whose
squares add to one, so the spatial statistics are those of A_k at all times. With a phase that is uniform over
observations the correlation in time of any Fourier mode of the layer, in the frame that moves with it, is

    rho(t) = (1 - t / 2 T) cos(pi t / 2 T) + sin(pi t / 2 T) / pi    for t < 2 T, else 0.

It begins as 1 - pi^2 t^2 / 8 T^2, so the layer is smooth in time. All scales decorrelate in one time; real eddies live
longer the larger they are.

Realizations take turns: A_k is that of the number k modulo their count, which is 2 where T is as long as a scan or
longer. One that returns has no correlation with itself, in the mean over its signs. It has a random correlation in
each observation, though, so powers scatter more than those of realizations that never return.

Realizations have a mean of 0 over the rectangle of each scan: the mean of a layer without an outer scale has no finite
variance, and all that its changes add is a slow signal that detectors share. So the covariance of two samples of one
scan is that of the frozen layer, relative to the mean over the rectangle, times the correlation.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np


def evolution_correlation(lag_s: float | np.ndarray, decorrelation_s: float) -> np.ndarray:
    """Correlation in time of a layer, in the frame that moves with it, mean over the phase and the signs."""
    lag = np.minimum(np.abs(lag_s) / decorrelation_s, 2.0)
    return (1.0 - lag / 2.0) * np.cos(np.pi * lag / 2.0) + np.sin(np.pi * lag / 2.0) / np.pi


@dataclass(frozen=True)
class Evolution:
    """Realizations of a layer over an observation.

    Attributes
    ----------
    decorrelation_s
    count
        Number of realizations.
    phase
        From 0 to 1.
    signs : (n,)
        Signs of the turns of the realizations, 1 or -1.
    """

    decorrelation_s: float
    count: int
    phase: float
    signs: np.ndarray

    def weight(self, number: int, time_s: np.ndarray) -> np.ndarray:
        """Weights of the realization with a number at some times since the start of the observation."""
        place = time_s / self.decorrelation_s + self.phase
        turn = np.floor(place).astype(np.int64)
        quarter = 0.5 * np.pi * (place - turn)
        fading = np.where(turn % self.count == number, self.signs[turn] * np.cos(quarter), 0.0)
        return fading + np.where((turn + 1) % self.count == number, self.signs[turn + 1] * np.sin(quarter), 0.0)


def draw_evolution(decorrelation_s: float, *, scan_s: float, end_s: float, rng: np.random.Generator) -> Evolution:
    """Draw the phase and the signs of an observation until some time.

    Parameters
    ----------
    decorrelation_s
    scan_s
        Duration of a scan: while it lasts no realization returns, but for the first one as the last.
    end_s
    rng
    """
    count = 1 + max(1, ceil(scan_s / decorrelation_s))
    phase = float(rng.random())
    return Evolution(decorrelation_s, count, phase, rng.choice([-1.0, 1.0], ceil(end_s / decorrelation_s) + 3))
