"""Lost data of an observation: dropped samples, dead detectors and lost scans, as flags (n_det, n_samp)."""

import numpy as np

from surveysim.runtime.rng import generator
from surveysim.scene.readout import DroppedSamples
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.observed_block import ObservedBlock
from surveysim.timestreams.sharing import common_streams


def gap_length(section: DroppedSamples, sample_rate_hz: float) -> int:
    """Samples of a gap, one or more."""
    return max(1, round(section.length_s * sample_rate_hz))


def flag_dropped_samples(lost: np.ndarray, of: ObservedBlock) -> None:
    """Flag the gaps of a block, in place; scans have the ends of gaps that begin before them."""
    from mapmaker.kernels.lost_samples import flag_runs

    section, scans, rng = of.setup.scene.dropped_samples, of.setup.observing.scans, of.generator("dropped_samples")
    stream = common_streams(of.setup.camera, section.shared, section.group_size)
    n_samp, length, n_scans = samples_per_scan(scans), gap_length(section, scans.sample_rate_hz), of.block.n_scans
    expected = section.rate_hz / scans.sample_rate_hz * (n_samp + length - 1)
    count = rng.poisson(expected, (int(stream.max()) + 1, n_scans))
    of_stream, scan = (np.repeat(number.ravel(), count.ravel()) for number in np.indices(count.shape))
    start = rng.integers(1 - length, n_samp, len(of_stream))
    first, end = scan * n_samp + np.maximum(start, 0), scan * n_samp + np.minimum(start + length, n_samp)
    if section.shared == "detector":
        flag_runs(lost, of_stream, first, end)
        return
    gone = np.zeros((len(count), lost.shape[1]), bool)
    flag_runs(gone, of_stream, first, end)
    lost |= gone[stream]


def flag_dead_time(lost: np.ndarray, of: ObservedBlock) -> None:
    """Flag the dead detectors and the lost scans of an observation in one of its blocks, in place.

    Bands of a camera lose the same scans.
    """
    section, n_samp = of.setup.scene.dead_time, samples_per_scan(of.setup.observing.scans)
    of_detectors = generator(of.setup.scene.seed, "dead_time.detectors", of.observation, band=of.setup.scene.band_name)
    of_scans = generator(of.setup.scene.seed, "dead_time.scans", of.observation)
    lost[_some(section.detectors, of.setup.camera.n_det, of_detectors)] = True
    gone = _some(section.scans, of.setup.observing.scans.n_scans, of_scans)
    lost[:, np.repeat(gone[of.block.first : of.block.end], n_samp)] = True


def _some(share: float, n: int, rng: np.random.Generator) -> np.ndarray:
    """Choose a share of n at random, (n,) bool, but one is left; their mean number is exactly ``share n``."""
    number = min(n - 1, int(share * n + rng.random()))
    return rng.permutation(n) < number


def most_dead(share: float, n_det: int) -> int:
    """Largest number of detectors that are dead in an observation."""
    return min(n_det - 1, int(np.ceil(share * n_det)))
