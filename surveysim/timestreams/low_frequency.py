"""Excess noise at low frequencies: a power law of frequency, correlated between detectors."""

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.runtime.rng import NormalDeviates, RandomPurpose
from surveysim.scene.noise_and_sky import Excess
from surveysim.telescope.lattice_noise import LatticeFactor
from surveysim.timestreams.noise import draw_from_psd, mode_amplitude
from surveysim.timestreams.observed_block import ObservedBlock


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

    Streams are drawn with twice the length of a scan, so its end is not correlated with its beginning. No shorter
    period is exact: a period of m samples makes the correlations at the lags t and m - t equal.

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
    streams = streams.reshape(n_det, n_samp)
    data_mk += streams if factor is None else factor.astype(np.float32) @ streams


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
