"""One-sided PSDs of time-streams, their white level and their variance at low frequencies."""

from functools import lru_cache

import numpy as np

from mapmaker.chunks import row_chunks


def hann_psd(data_mk: np.ndarray, n_scans: int, kept: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """Mean over kept scans of the one-sided PSD (n_det, n_samp // n_scans // 2 + 1) [mK^2/Hz], mean-removed and
    Hann-tapered.

    The taper keeps the red noise of a short scan from leaking into the white level.
    """
    power = hann_power(data_mk, n_scans, kept) / kept.sum()
    return power * hann_scale(data_mk.shape[1] // n_scans, sample_rate_hz, data_mk.dtype)


def hann_power(data_mk: np.ndarray, n_scans: int, kept: np.ndarray) -> np.ndarray:
    """Squared transforms (n_det, n_samp // n_scans // 2 + 1) float64 of mean-removed, Hann-tapered scans, summed over
    kept scans.
    """
    from scipy.fft import rfft

    from mapmaker.kernels.spectra import add_power, taper_scans

    n_det, n_samp = data_mk.shape
    n, n_kept = n_samp // n_scans, int(kept.sum())
    taper, total = _hann(n, data_mk.dtype), np.zeros((n_det, n // 2 + 1))
    for rows in row_chunks(n_det, 2 * n_samp):
        scans = np.empty((len(total[rows]), n_kept, n), data_mk.dtype)
        taper_scans(data_mk[rows], kept, taper, scans)
        add_power(rfft(scans, axis=-1), total[rows])
    return total


@lru_cache(maxsize=16)  # for every observation
def hann_scale(n: int, sample_rate_hz: float, dtype: np.dtype) -> float:
    """Factor [1 / Hz] from the mean `hann_power` of scans of n samples to their one-sided PSD."""
    return 2 / (sample_rate_hz * float((_hann(n, dtype).astype(float) ** 2).sum()))


@lru_cache(maxsize=16)
def _hann(n: int, dtype: np.dtype) -> np.ndarray:
    taper = np.hanning(n + 1)[:n].astype(dtype)
    taper.flags.writeable = False
    return taper


def low_frequency_variance(data_mk: np.ndarray, n_scans: int, sample_rate_hz: float, up_to_hz: float) -> np.ndarray:
    """Variance (n_det,) [mK^2] of mean-removed scans at frequencies up to `up_to_hz`, averaged over scans.

    That is how Table 2 counts: the mean of a scan is removed, nothing else.
    """
    from scipy.fft import rfft

    n_det, n_samp = data_mk.shape
    n = n_samp // n_scans
    spectrum = rfft(data_mk.reshape(n_det, n_scans, n), axis=-1)
    band = slice(1, int(np.floor(up_to_hz * n / sample_rate_hz + 1e-9)) + 1)
    power = spectrum.real[..., band] ** 2 + spectrum.imag[..., band] ** 2
    return 2 * power.sum(axis=-1, dtype=np.float64).mean(axis=1) / n**2


def highest_frequency(n: int, sample_rate_hz: float) -> float:
    """The highest frequency [Hz] of n samples below Nyquist's."""
    return (n - 1) // 2 * sample_rate_hz / n


def white_level(psd_mk2_hz: np.ndarray, n: int, sample_rate_hz: float, above_hz: float) -> np.ndarray:
    """White level (n_det,) [mK^2/Hz]: the mean above `above_hz` of PSDs of n samples, Nyquist excluded.

    `highest_frequency` says what `above_hz` must lie below.
    """
    frequency = np.fft.rfftfreq(n, 1 / sample_rate_hz)
    high = (frequency > above_hz) & (frequency < sample_rate_hz / 2)
    return psd_mk2_hz[:, high].mean(axis=1)
