"""Microphonic lines: narrow-band noise about a frequency, of each detector, a readout group or the whole array."""

import numpy as np

from mapmaker.chunks import row_chunks
from surveysim.runtime.rng import NormalDeviates
from surveysim.scene.readout import MicrophonicLine
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.sharing import common_streams

_REACH = 2.0  # widths on both sides of a line that are drawn: all of a Gaussian but 2e-6


def add_lines(data_mk: np.ndarray, of: ObservedBlock) -> None:
    """Add the lines of a block to streams (n_det, n_samp), in place; scans have independent phases."""
    rate = of.setup.observing.scans.sample_rate_hz
    for number, line in enumerate(of.setup.scene.lines):
        stream = common_streams(of.setup.camera, line.shared, line.group_size)
        deviates = of.deviates("lines", realization=number)
        add_line(data_mk, line, stream=stream, n_scans=of.block.n_scans, sample_rate_hz=rate, deviates=deviates)


def line_components(line: MicrophonicLine, n: int, sample_rate_hz: float) -> tuple[np.ndarray, np.ndarray]:
    """Divide a line into waves of n samples about its frequency.

    Returns
    -------
    frequency_hz, variance_mk2 : (n,)
        A line much narrower than a step is one wave; the sum of the variances is that of the line.
    """
    from scipy.special import ndtr

    sigma, step_hz = line.width_hz / np.sqrt(8 * np.log(2)), sample_rate_hz / n
    most = min(int(np.ceil(_REACH * line.width_hz / step_hz)), (n - 1) // 2)
    offset = np.arange(-most, most + 1) * step_hz
    share = ndtr((offset + step_hz / 2) / sigma) - ndtr((offset - step_hz / 2) / sigma)
    return line.frequency_hz + offset, line.rms_mk**2 * share / share.sum()


def add_line(
    data_mk: np.ndarray,
    line: MicrophonicLine,
    *,
    stream: np.ndarray,
    n_scans: int,
    sample_rate_hz: float,
    deviates: NormalDeviates,
) -> None:
    """Add a line to whole scans of streams (n_det, n_samp), in place, as waves with a period of two scans about it.

    Parameters
    ----------
    stream : (n_det,)
        Number of the noise stream that each detector has.
    """
    from scipy.fft import ifft

    per_scan, n_stream = data_mk.shape[1] // n_scans, int(stream.max()) + 1
    n = 2 * per_scan
    frequency, variance = line_components(line, n, sample_rate_hz)
    # A wave of the variance v has a complex amplitude with deviations sqrt(v) of both parts.
    amplitude = np.sqrt(variance).astype(np.float32)
    cell = (np.arange(len(frequency)) - len(frequency) // 2) % n
    turn = np.exp(2j * np.pi * line.frequency_hz / sample_rate_hz * np.arange(per_scan)).astype(np.complex64)
    for rows in row_chunks(n_stream, 4 * data_mk.shape[1]):
        shape = (rows.stop - rows.start, n_scans)
        first = rows.start * n_scans * 2 * len(frequency)
        drawn = deviates.draw((*shape, len(frequency), 2), first=first).view(np.complex64)[..., 0] * amplitude
        modes = np.zeros((*shape, n), np.complex64)
        modes[..., cell] = drawn
        waves = (ifft(modes, axis=-1, norm="forward", overwrite_x=True)[..., :per_scan] * turn).real
        detectors = np.flatnonzero((stream >= rows.start) & (stream < rows.stop))
        data_mk[detectors] += waves.reshape(shape[0], -1)[stream[detectors] - rows.start]
