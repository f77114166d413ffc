"""Noise streams other than the atmosphere: white, photon with overlap, excess at low frequency.

One-sided PSDs throughout; streams are (n_det, n_samp) float32 with whole scans side by side.
"""

import numpy as np

from surveysim.sections import Excess


def add_white(data_mk: np.ndarray, psd_mk2_hz: float, sample_rate_hz: float, rng: np.random.Generator) -> None:
    """Add white noise of one-sided PSD `psd_mk2_hz`, independent in each detector, in place."""
    deviates = rng.standard_normal(data_mk.shape, dtype=np.float32)
    deviates *= np.float32(np.sqrt(psd_mk2_hz * sample_rate_hz / 2))
    data_mk += deviates


def add_correlated_white(
    data_mk: np.ndarray,
    psd_mk2_hz: float,
    sample_rate_hz: float,
    factor: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Add white noise of one-sided PSD `psd_mk2_hz` with correlation ``factor factor^T``, in place."""
    scaled = (factor * np.sqrt(psd_mk2_hz * sample_rate_hz / 2)).astype(np.float32)
    data_mk += scaled @ rng.standard_normal(data_mk.shape, dtype=np.float32)


def photon_correlation(correlation: np.ndarray, coherent_fraction: float) -> np.ndarray:
    """Correlation of photon noise (n_det, n_det): only the coherent part of the load is shared (section 5.1)."""
    return coherent_fraction * correlation + (1 - coherent_fraction) * np.eye(len(correlation))


def excess_variance(section: Excess, b2: float | None) -> float:
    """Excess variance below the band limit [mK^2] at one B2: log-log through the knots (Table 2).

    Held constant beyond the outermost knots: the paper has no data there.
    """
    if b2 is None or len(section.b2) == 1:
        return section.variance_mk2[0]
    return float(np.exp(np.interp(np.log(max(b2, 1e-300)), np.log(section.b2), np.log(section.variance_mk2))))


def excess_psd(section: Excess, variance_mk2: float, n_samp: int, n: int, sample_rate_hz: float) -> np.ndarray:
    """One-sided PSD [mK^2/Hz] A f^-index at the rfft frequencies of n samples, 0 at f = 0.

    A is such that a scan of `n_samp` samples, its mean removed, has the variance `variance_mk2` below the
    band limit, which is how Table 2 counts it: ``sum A f^-index (1 - sinc^2(f T)) df`` over the n-sample
    grid that is drawn.
    """
    frequency = np.arange(n // 2 + 1) * (sample_rate_hz / n)
    shape = np.zeros(len(frequency))
    shape[1:] = frequency[1:] ** (-section.spectral_index)
    band = frequency <= section.band_limit_hz
    left = 1 - np.sinc(frequency[band] * n_samp / sample_rate_hz) ** 2
    return shape * (variance_mk2 / (np.sum(shape[band] * left) * sample_rate_hz / n))


def draw_from_psd(
    psd_mk2_hz: np.ndarray, shape: tuple, n: int, sample_rate_hz: float, rng: np.random.Generator
) -> np.ndarray:
    """Gaussian streams (*shape, n) float32 of a one-sided PSD given at the rfft frequencies of n samples.

    `psd_mk2_hz` is (..., n // 2 + 1) and broadcasts against (*shape, n // 2 + 1). Each stream is
    periodic in n samples and has no mean.
    """
    from scipy.fft import irfft

    n_freq = n // 2 + 1
    amplitude = np.sqrt(psd_mk2_hz * (sample_rate_hz * n / 4))
    amplitude[..., 0] = 0
    if n % 2 == 0:  # the Nyquist mode is real: all its power is in one deviate
        amplitude[..., -1] *= np.sqrt(2)
    deviates = rng.standard_normal((*shape, n_freq, 2), dtype=np.float32).view(np.complex64)[..., 0]
    deviates *= amplitude.astype(np.float32)
    return irfft(deviates, n, axis=-1, overwrite_x=True)


def add_excess(
    data_mk: np.ndarray,
    section: Excess,
    variance_mk2: float,
    n_scans: int,
    sample_rate_hz: float,
    factor: np.ndarray,
    rng: np.random.Generator,
) -> None:
    """Add the excess low-frequency noise of one observation, correlated as ``factor factor^T``, in place.

    Drawn over twice the length of a scan, so that its end does not know of its beginning.
    """
    from scipy.fft import next_fast_len

    n_det, n_samp = data_mk.shape
    per_scan = n_samp // n_scans
    n = next_fast_len(2 * per_scan, real=True)
    psd = excess_psd(section, variance_mk2, per_scan, n, sample_rate_hz)
    streams = draw_from_psd(psd, (n_det, n_scans), n, sample_rate_hz, rng)[..., :per_scan]
    data_mk += factor.astype(np.float32) @ np.ascontiguousarray(streams).reshape(n_det, n_samp)


def hann_psd(data_mk: np.ndarray, n_scans: int, kept: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """One-sided Hann-tapered PSD (n_det, n_samp // n_scans // 2 + 1) [mK^2/Hz], the mean over kept scans.

    The taper keeps the red noise of a short scan from leaking into the white level.
    """
    from scipy.fft import rfft

    n_det, n_samp = data_mk.shape
    n = n_samp // n_scans
    taper = np.hanning(n + 1)[:n].astype(data_mk.dtype)
    spectrum = rfft(data_mk.reshape(n_det, n_scans, n)[:, kept] * taper, axis=-1)
    power = (spectrum.real**2 + spectrum.imag**2).mean(axis=1, dtype=np.float64)
    return power * (2 / (sample_rate_hz * float((taper.astype(float) ** 2).sum())))


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
