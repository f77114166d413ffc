"""Scaling of normal equations, so that all modes of a map converge alike.

The normal matrix of a map-maker is about ``W^1/2 C W^1/2``, with the weights W of the white noise, and a convolution C
that has little weight for modes with much low-frequency noise. Scaled by the roots of both it is about 1.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

_PROBES = 4
_LEAST = 1e-3  # of the weight of a mode, relative to white noise


@dataclass(frozen=True)
class Scaling:
    """Square root L of the preconditioner: ``L^T A L`` is about 1.

    Attributes
    ----------
    pixels : (n_y, n_x)
        Inverse root of the weight; 0 in pixels without weight.
    modes : (n_y, n_x // 2 + 1)
        Inverse root of the weight of each Fourier mode, on the half plane of `rfft2`.
    """

    pixels: np.ndarray
    modes: np.ndarray

    def __call__(self, sky: np.ndarray) -> np.ndarray:
        """Apply L to flat maps (n_sky, n_pixel)."""
        return (self.pixels * self._convolved(sky)).reshape(sky.shape)

    def back(self, sky: np.ndarray) -> np.ndarray:
        """Apply L^T to flat maps (n_sky, n_pixel)."""
        return self._convolved(sky.reshape(-1, *self.pixels.shape) * self.pixels).reshape(sky.shape)

    def _convolved(self, sky: np.ndarray) -> np.ndarray:
        from scipy.fft import irfft2, rfft2

        shape = self.pixels.shape
        return irfft2(rfft2(sky.reshape(-1, *shape)) * self.modes, shape)


def scaling(apply: Callable[[np.ndarray], np.ndarray], weight: np.ndarray) -> Scaling:
    """Measure the scaling of a normal matrix with maps of random signs, always the same.

    Parameters
    ----------
    apply
        Function that applies the normal matrix to skies (n_sky, n_pixel).
    weight : (n_y, n_x)
        Weights of the white noise alone.
    """
    from scipy.fft import fft2
    from scipy.ndimage import gaussian_filter

    pixels = np.sqrt(np.divide(1.0, weight, out=np.zeros(weight.shape), where=weight > 0))
    bits = np.random.PCG64(0).random_raw(-(-_PROBES * weight.size // 64)).view(np.uint8)
    signs = 2.0 * np.unpackbits(bits, count=_PROBES * weight.size).reshape(_PROBES, *weight.shape) - 1
    signs[:, weight == 0] = 0
    seen = apply((pixels * signs).reshape(_PROBES, -1)).reshape(signs.shape) * pixels
    # Signs are independent from pixel to pixel: their Fourier modes single out the diagonal of the matrix.
    probes, answers = fft2(signs), fft2(seen)
    both = (np.sum(probes.conj() * answers, axis=0).real, np.sum(np.abs(probes) ** 2, axis=0))
    answer, power = (gaussian_filter(item, 1.0, mode="wrap") for item in both)
    share = np.divide(answer, power, out=np.ones(power.shape), where=power > 0)
    return Scaling(pixels, np.maximum(share, _LEAST)[:, : weight.shape[1] // 2 + 1] ** -0.5)
