"""Excess noise at low frequencies: a power law of frequency, correlated between detectors."""

from functools import lru_cache

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.chunks import row_chunks
from surveysim.runtime.rng import NormalDeviates, RandomPurpose
from surveysim.scene.noise_and_sky import Excess
from surveysim.telescope.lattice_noise import LatticeFactor
from surveysim.timestreams.noise import draw_from_psd, mode_amplitude
from surveysim.timestreams.observed_block import ObservedBlock

# Samples of a scan. Shorter ones are drawn sooner by the root of their covariance than by Fourier transforms.
LONGEST_ROOT = 200


def add_low_frequency_noise(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the excess noise of a block to streams (n_det, n_samp), in place."""
    setup, weather = of.setup, of.weather
    section = setup.scene.excess
    variance = excess_variance(section, None if weather is None else weather.b2)
    add_excess(
        data_mk,
        section,
        variance_mk2=variance,
        n_scans=of.block.n_scans,
        sample_rate_hz=setup.observing.scans.sample_rate_hz,
        factor=setup.camera.excess_factor,
        deviates=of.deviates(RandomPurpose.EXCESS),
    )


def excess_variance(section: Excess, b2: float | None) -> float:
    """Excess variance below the band limit [mK^2] at one B2 (`excess_variances`); that of the first knot for None."""
    return section.variance_mk2[0] if b2 is None else float(excess_variances(section, np.asarray(b2)))


def excess_variances(section: Excess, b2: np.ndarray) -> np.ndarray:
    """Interpolate the excess variance below the band limit [mK^2], log-log between knots of B2 (Table 2).

    It is constant beyond the outermost knots, where the paper has no data.
    """
    if len(section.b2) == 1:
        return np.full(b2.shape, section.variance_mk2[0])
    return np.exp(np.interp(np.log(np.maximum(b2, 1e-300)), np.log(section.b2), np.log(section.variance_mk2)))


def excess_psd(section: Excess, variance_mk2: float, n_samp: int, n: int, sample_rate_hz: float) -> np.ndarray:
    """Compute the one-sided PSD A f^-index of the excess noise, 0 at f = 0.

    The amplitude A gives a mean-removed scan of the duration T the variance `variance_mk2` below the band limit, as in
    Table 2: ``sum A f^-index (1 - sinc^2(f T)) df`` over the frequencies of n samples.

    Parameters
    ----------
    n_samp
        Samples of a scan.
    n
        Samples of the streams that are drawn.

    Returns
    -------
    (n // 2 + 1,) array [mK^2/Hz]
        At the rfft frequencies of n samples.
    """
    frequency = np.arange(n // 2 + 1) * (sample_rate_hz / n)
    shape = np.zeros(len(frequency))
    shape[1:] = frequency[1:] ** (-section.spectral_index)
    band = frequency <= section.band_limit_hz
    left = 1 - np.sinc(frequency[band] * n_samp / sample_rate_hz) ** 2
    return shape * (variance_mk2 / (np.sum(shape[band] * left) * sample_rate_hz / n))


def add_excess(
    data_mk: np.ndarray,
    section: Excess,
    *,
    variance_mk2: float,
    n_scans: int,
    sample_rate_hz: float,
    factor: np.ndarray | LatticeFactor | None,
    deviates: NormalDeviates,
) -> None:
    """Add the excess noise of whole scans to streams (n_det, n_samp), in place.

    Streams have the covariance of a stretch of streams with twice the length of a scan, so its end is not correlated
    with its beginning. Scans of up to `LONGEST_ROOT` samples are drawn by the root of this covariance, longer ones and
    those of many detectors as such streams. No shorter period is exact: a period of m samples makes the correlations
    at the lags t and m - t equal.

    Parameters
    ----------
    variance_mk2
        Variance below the band limit.
    factor
        Factor of the correlation between detectors, ``factor factor^T``; None for independent detectors.
    """
    from scipy.fft import next_fast_len

    n_det, n_samp = data_mk.shape
    per_scan = n_samp // n_scans
    if not isinstance(factor, LatticeFactor) and per_scan <= LONGEST_ROOT:
        root = np.float32(variance_mk2**0.5) * _scan_root(section, per_scan, sample_rate_hz)
        streams = np.empty((n_det * n_scans, per_scan), np.float32)
        for rows in row_chunks(len(streams), per_scan):
            normals = deviates.draw(streams[rows].shape, first=rows.start * per_scan)
            np.matmul(normals, root, out=streams[rows])
        _add_correlated(data_mk, streams, factor)
        return
    n = next_fast_len(2 * per_scan, real=True)
    psd = excess_psd(section, variance_mk2, per_scan, n, sample_rate_hz)
    if isinstance(factor, LatticeFactor):
        amplitude = mode_amplitude(psd, n, sample_rate_hz)
        for scan in range(n_scans):
            samples = slice(scan * per_scan, (scan + 1) * per_scan)
            _add_lattice_scan(data_mk[:, samples], amplitude, n, scan=scan, root=factor, deviates=deviates)
        return
    streams = np.empty((n_det, n_scans, per_scan), np.float32)
    for rows in row_chunks(n_det, 2 * n_samp):
        shape, first = streams[rows].shape[:2], rows.start * n_scans
        drawn = draw_from_psd(psd, shape, n, sample_rate_hz, deviates, first_stream=first)
        streams[rows] = drawn[..., :per_scan]
    _add_correlated(data_mk, streams, factor)


def _add_correlated(data_mk: np.ndarray, streams: np.ndarray, factor: np.ndarray | None) -> None:
    """Add independent streams of as many samples, correlated by a factor, in place."""
    streams = streams.reshape(data_mk.shape)
    data_mk += streams if factor is None else factor.astype(np.float32) @ streams


@lru_cache(maxsize=8)  # sections of the bands of a camera
@threadpool_limits.wrap(limits=1)  # the last bits of eigenvectors depend on the number of BLAS threads
def _scan_root(section: Excess, n_samp: int, sample_rate_hz: float) -> np.ndarray:
    """Symmetric root (n_samp, n_samp) of the covariance of a scan with unit variance.

    It depends on the covariance alone, without the signs and the order of eigenvectors, and hardly changes with the
    spectral index: sections that differ little share their noise.
    """
    psd = excess_psd(section, 1.0, n_samp, 2 * n_samp, sample_rate_hz)
    lag = np.abs(np.arange(n_samp) - np.arange(n_samp)[:, None])
    value, vector = np.linalg.eigh(np.fft.irfft(psd)[lag] * (sample_rate_hz / 2))
    return ((vector * np.sqrt(np.maximum(value, 0))) @ vector.T).astype(np.float32)


def _add_lattice_scan(
    data_mk: np.ndarray,
    amplitude: np.ndarray,
    n: int,
    *,
    scan: int,
    root: LatticeFactor,
    deviates: NormalDeviates,
) -> None:
    """Add one scan, whose Fourier modes are fields on the lattice of the detectors, in place."""
    from scipy.fft import irfft

    n_det, per_scan = data_mk.shape
    modes = np.empty((n_det, len(amplitude)), np.complex64)
    for places, fields in root.fields(len(amplitude), deviates, first=scan * len(amplitude)):
        np.multiply(fields, amplitude[places], out=modes[:, places])
    for rows in row_chunks(n_det, n):
        data_mk[rows] += irfft(modes[rows], n, axis=-1, overwrite_x=True)[:, :per_scan]
