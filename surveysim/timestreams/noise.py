"""Noise streams other than the atmosphere: white, photon with overlap, excess at low frequency.

One-sided PSDs throughout; streams are (n_det, n_samp) float32 with whole scans side by side.
"""

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.scene.noise_and_sky import Excess
from surveysim.telescope.lattice_noise import CirculantFactor


def add_white(data_mk: np.ndarray, psd_mk2_hz: float, sample_rate_hz: float, rng: np.random.Generator) -> None:
    """Add white noise of one-sided PSD `psd_mk2_hz`, independent in each detector, in place."""
    for rows in row_chunks(*data_mk.shape):
        deviates = rng.standard_normal(data_mk[rows].shape, dtype=np.float32)
        deviates *= np.float32(np.sqrt(psd_mk2_hz * sample_rate_hz / 2))
        data_mk[rows] += deviates


def add_correlated_white(
    data_mk: np.ndarray,
    psd_mk2_hz: float,
    sample_rate_hz: float,
    factor: np.ndarray | CirculantFactor,
    rng: np.random.Generator,
) -> None:
    """Add white noise of one-sided PSD `psd_mk2_hz` with correlation ``factor factor^T``, in place."""
    deviation = np.sqrt(psd_mk2_hz * sample_rate_hz / 2)
    if isinstance(factor, CirculantFactor):
        n_samp = data_mk.shape[1]
        for places, fields in factor.fields((n_samp + 1) // 2, rng):
            fields *= np.float32(deviation)
            first, end = 2 * places.start, min(2 * places.stop, n_samp)
            data_mk[:, first:end] += fields.view(np.float32)[:, : end - first]
        return
    data_mk += (factor * deviation).astype(np.float32) @ rng.standard_normal(data_mk.shape, dtype=np.float32)


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

    deviates = rng.standard_normal((*shape, n // 2 + 1, 2), dtype=np.float32).view(np.complex64)[..., 0]
    deviates *= _mode_amplitude(psd_mk2_hz, n, sample_rate_hz)
    return irfft(deviates, n, axis=-1, overwrite_x=True)


def _mode_amplitude(psd_mk2_hz: np.ndarray, n: int, sample_rate_hz: float) -> np.ndarray:
    """Standard deviation float32 of both parts of the modes of n samples with this one-sided PSD, without a mean."""
    amplitude = np.sqrt(psd_mk2_hz * (sample_rate_hz * n / 4))
    amplitude[..., 0] = 0
    if n % 2 == 0:  # the Nyquist mode is real: all its power is in one deviate
        amplitude[..., -1] *= np.sqrt(2)
    return amplitude.astype(np.float32)


def add_excess(
    data_mk: np.ndarray,
    section: Excess,
    variance_mk2: float,
    n_scans: int,
    sample_rate_hz: float,
    factor: np.ndarray | CirculantFactor | None,
    rng: np.random.Generator,
) -> None:
    """Add the excess low-frequency noise of some scans, correlated as ``factor factor^T`` (None: not), in place.

    Drawn over twice the length of a scan, so that its end does not know of its beginning.
    """
    from scipy.fft import next_fast_len

    n_det, n_samp = data_mk.shape
    per_scan = n_samp // n_scans
    n = next_fast_len(2 * per_scan, real=True)
    psd = excess_psd(section, variance_mk2, per_scan, n, sample_rate_hz)
    if isinstance(factor, CirculantFactor):
        for first in range(0, n_samp, per_scan):
            _add_lattice_scan(data_mk[:, first : first + per_scan], psd, n, sample_rate_hz, factor, rng)
        return
    streams = np.empty((n_det, n_scans, per_scan), np.float32)
    for rows in row_chunks(n_det, 2 * n_samp):
        streams[rows] = draw_from_psd(psd, streams[rows].shape[:2], n, sample_rate_hz, rng)[..., :per_scan]
    streams = streams.reshape(n_det, n_samp)
    data_mk += streams if factor is None else factor.astype(np.float32) @ streams


def _add_lattice_scan(
    data_mk: np.ndarray,
    psd_mk2_hz: np.ndarray,
    n: int,
    sample_rate_hz: float,
    root: CirculantFactor,
    rng: np.random.Generator,
) -> None:
    """Add the first samples of streams of n samples, each of whose frequencies is a field on the torus, in place."""
    from scipy.fft import irfft

    n_det, per_scan = data_mk.shape
    amplitude = _mode_amplitude(psd_mk2_hz, n, sample_rate_hz)
    modes = np.empty((n_det, len(amplitude)), np.complex64)
    for places, fields in root.fields(len(amplitude), rng):
        np.multiply(fields, amplitude[places], out=modes[:, places])
    for rows in row_chunks(n_det, n):
        data_mk[rows] += irfft(modes[rows], n, axis=-1, overwrite_x=True)[:, :per_scan]


def hann_psd(data_mk: np.ndarray, n_scans: int, kept: np.ndarray, sample_rate_hz: float) -> np.ndarray:
    """One-sided Hann-tapered PSD (n_det, n_samp // n_scans // 2 + 1) [mK^2/Hz], the mean over kept scans.

    The taper keeps the red noise of a short scan from leaking into the white level.
    """
    power = hann_power(data_mk, n_scans, kept) / kept.sum()
    return power * hann_scale(data_mk.shape[1] // n_scans, sample_rate_hz, data_mk.dtype)


def hann_power(data_mk: np.ndarray, n_scans: int, kept: np.ndarray) -> np.ndarray:
    """Squared Hann-tapered transforms (n_det, n_samp // n_scans // 2 + 1) float64, summed over kept scans."""
    from scipy.fft import rfft

    n_det, n_samp = data_mk.shape
    n = n_samp // n_scans
    taper, total = _hann(n, data_mk.dtype), np.zeros((n_det, n // 2 + 1))
    if kept.any():
        for rows in row_chunks(n_det, n_samp):
            spectrum = rfft(data_mk[rows].reshape(-1, n_scans, n)[:, kept] * taper, axis=-1)
            total[rows] = (spectrum.real**2 + spectrum.imag**2).sum(axis=1, dtype=np.float64)
    return total


def hann_scale(n: int, sample_rate_hz: float, dtype: np.dtype) -> float:
    """What makes one-sided PSDs of means of `hann_power` of scans of n samples."""
    return 2 / (sample_rate_hz * float((_hann(n, dtype).astype(float) ** 2).sum()))


def _hann(n: int, dtype: np.dtype) -> np.ndarray:
    return np.hanning(n + 1)[:n].astype(dtype)


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
