"""1/f noise of the readout: of each detector, common to the detectors of a readout group, and common to all."""

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.runtime.rng import NormalDeviates
from surveysim.scene.readout import RedNoise
from surveysim.timestreams.noise import draw_from_psd
from surveysim.timestreams.observed_block import ObservedBlock, mean_white
from surveysim.timestreams.sharing import common_streams


def add_readout_noise(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the 1/f noise of a block to streams (n_det, n_samp), in place; scans are independent, as in excess noise."""
    setup = of.setup
    for shared, part in setup.scene.readout_noise.parts.items():
        level = mean_white(of) if part.psd_mk2_hz is None else part.psd_mk2_hz
        purpose = f"readout_noise.{shared}"
        add_red_noise(
            data_mk,
            part,
            psd_at_knee=level,
            stream=common_streams(setup.camera, shared, getattr(part, "group_size", None)),
            n_scans=of.block.n_scans,
            sample_rate_hz=setup.observing.scans.sample_rate_hz,
            deviates=(of.deviates(purpose), of.deviates(f"{purpose}.trend")),
        )


def red_psd(section: RedNoise, n: int, sample_rate_hz: float) -> np.ndarray:
    """Compute the one-sided PSD (n // 2 + 1,) of 1/f noise over that at the knee, 0 at f = 0, for streams of n samples.

    At the rfft frequencies; `trend_variance` has what lies below the first of them.
    """
    frequency = np.arange(n // 2 + 1) * (sample_rate_hz / n)
    psd = np.zeros(len(frequency))
    psd[1:] = (frequency[1:] / section.knee_hz) ** -section.slope
    return psd


def trend_variance(section: RedNoise, n: int, sample_rate_hz: float) -> float:
    """Variance [s^-2] of the rate of change of noise below half of the first frequency of n samples, over PSD at knee.

    In a scan, noise of so low a frequency is a trend: ``int P(f) (2 pi f)^2 df``. For a slope of 2, lines and trend
    have together exactly the structure function of the random walk, at lags up to n / 2 samples.
    """
    edge = sample_rate_hz / n / 2
    return 4 * np.pi**2 * section.knee_hz**section.slope * edge ** (3 - section.slope) / (3 - section.slope)


def add_red_noise(
    data_mk: np.ndarray,
    section: RedNoise,
    *,
    psd_at_knee: float,
    stream: np.ndarray,
    n_scans: int,
    sample_rate_hz: float,
    deviates: tuple[NormalDeviates, NormalDeviates],
) -> None:
    """Add 1/f noise to whole scans of streams (n_det, n_samp), in place.

    Lines are those of a period of twice a scan, with the trends of lower frequencies.

    Parameters
    ----------
    psd_at_knee
        One-sided PSD [mK^2/Hz].
    stream : (n_det,)
        Number of the noise stream that each detector has.
    deviates
        Those of the lines, and of the trends.
    """
    from scipy.fft import next_fast_len

    per_scan, n_stream = data_mk.shape[1] // n_scans, int(stream.max()) + 1
    n = next_fast_len(2 * per_scan, real=True)
    psd = psd_at_knee * red_psd(section, n, sample_rate_hz)
    slope = np.sqrt(psd_at_knee * trend_variance(section, n, sample_rate_hz)) / sample_rate_hz
    place = np.arange(per_scan) - (per_scan - 1) / 2
    of_lines, of_trends = deviates
    for rows in row_chunks(n_stream, 2 * data_mk.shape[1]):
        shape, first = (rows.stop - rows.start, n_scans), rows.start * n_scans
        drawn = draw_from_psd(psd, shape, n, sample_rate_hz, of_lines, first_stream=first)[..., :per_scan]
        drawn += (slope * of_trends.draw(shape, first=first))[..., None] * place.astype(np.float32)
        detectors = np.flatnonzero((stream >= rows.start) & (stream < rows.stop))
        data_mk[detectors] += drawn.reshape(shape[0], -1)[stream[detectors] - rows.start]
