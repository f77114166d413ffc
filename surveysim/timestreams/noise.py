"""Gaussian noise streams: white, correlated white, and of any PSD.

One-sided PSDs throughout; streams are (n_det, n_samp) float32 with whole scans side by side.
"""

import numpy as np

from surveysim.runtime.rng import NormalDeviates
from surveysim.telescope.lattice_noise import LatticeFactor


def add_white(
    data_mk: np.ndarray, psd_mk2_hz: float | np.ndarray, sample_rate_hz: float, deviates: NormalDeviates
) -> None:
    """Add white noise, independent in each detector, in place; its one-sided PSD is one number or one for each
    detector (n_det,).
    """
    deviation = np.sqrt(np.asarray(psd_mk2_hz) * sample_rate_hz / 2)
    if deviation.ndim == 0:
        deviates.add(data_mk, float(deviation))
        return
    for row, of_row in enumerate(deviation.tolist()):
        deviates.add(data_mk[row], of_row, first=row * data_mk.shape[1])


def _deviation(psd_mk2_hz: float | np.ndarray, n_det: int, sample_rate_hz: float) -> np.ndarray:
    """Standard deviation (n_det, 1) of the samples of white noise."""
    return np.sqrt(np.broadcast_to(psd_mk2_hz, n_det)[:, None] * sample_rate_hz / 2)


def add_correlated_white(
    data_mk: np.ndarray,
    psd_mk2_hz: float | np.ndarray,
    sample_rate_hz: float,
    factor: np.ndarray | LatticeFactor,
    deviates: NormalDeviates,
) -> None:
    """Add white noise with the correlation ``factor factor^T``, in place; PSD as for `add_white`."""
    deviation = _deviation(psd_mk2_hz, len(data_mk), sample_rate_hz)
    if isinstance(factor, LatticeFactor):
        n_samp = data_mk.shape[1]
        for places, fields in factor.fields((n_samp + 1) // 2, deviates):
            fields *= deviation.astype(np.float32)
            first, end = 2 * places.start, min(2 * places.stop, n_samp)
            data_mk[:, first:end] += fields.view(np.float32)[:, : end - first]
        return
    data_mk += (factor * deviation).astype(data_mk.dtype) @ deviates.draw(data_mk.shape, dtype=data_mk.dtype)


def draw_from_psd(
    psd_mk2_hz: np.ndarray,
    shape: tuple,
    n: int,
    sample_rate_hz: float,
    deviates: NormalDeviates,
    *,
    first_stream: int = 0,
) -> np.ndarray:
    """Draw Gaussian streams of a one-sided PSD; each is periodic in n samples and has no mean.

    Parameters
    ----------
    psd_mk2_hz : (..., n // 2 + 1)
        At the rfft frequencies of n samples; broadcasts against (*shape, n // 2 + 1).
    first_stream
        Streams of n samples that were drawn from the same deviates before.

    Returns
    -------
    (*shape, n) float32 array [mK]
    """
    from scipy.fft import irfft

    n_mode = n // 2 + 1
    modes = deviates.draw((*shape, n_mode, 2), first=first_stream * 2 * n_mode).view(np.complex64)[..., 0]
    modes *= mode_amplitude(psd_mk2_hz, n, sample_rate_hz)
    return irfft(modes, n, axis=-1, overwrite_x=True)


def mode_amplitude(psd_mk2_hz: np.ndarray, n: int, sample_rate_hz: float) -> np.ndarray:
    """Compute the float32 standard deviation of the real and imaginary parts of the modes of n samples."""
    amplitude = np.sqrt(psd_mk2_hz * (sample_rate_hz * n / 4))
    amplitude[..., 0] = 0
    if n % 2 == 0:  # the Nyquist mode is real: all its power is in one deviate
        amplitude[..., -1] *= np.sqrt(2)
    return amplitude.astype(np.float32)
