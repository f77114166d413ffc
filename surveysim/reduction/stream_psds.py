"""PSDs of the streams of an observation, block by block."""

from typing import Any

import numpy as np

from mapmaker.cleaning import Cleaned
from mapmaker.lost_samples import fill_flagged
from mapmaker.stream_psd import hann_power, hann_scale
from surveysim.telescope.scans import Scans, samples_per_scan
from surveysim.timestreams.observation import DrawnBlock


def psd_scale(scans: Scans, dtype: np.dtype) -> float:
    """Factor from the mean `hann_power` of scans to their PSD."""
    return hann_scale(samples_per_scan(scans), scans.sample_rate_hz, dtype)


def cleaned_power(streams: DrawnBlock, rows: np.ndarray | slice, item: Cleaned) -> np.ndarray:
    """Sum over kept scans of the power (n_det, n_freq) of cleaned streams, with their own gaps filled anew.

    What fills a gap before cleaning does not follow the layer as the stream would, and maps leave it out.
    """
    data = item.data_mk
    if streams.flags is not None:
        data = fill_flagged(data, streams.scan_bounds, streams.flags[rows])
    return hann_power(data, len(item.kept), item.kept)


def sampled_scans(streams: DrawnBlock, rows: np.ndarray | slice, kept: np.ndarray) -> np.ndarray:
    """Number (n,) of kept scans of some detectors less the part of lost samples: filled gaps have no white noise.

    Samples count as in a periodogram, by the squared Hann taper: turnarounds at the ends of scans hardly do.
    """
    n_kept = int(kept.sum())
    if streams.flags is None or not n_kept:
        return np.full(len(streams.data_mk[rows]), float(n_kept))
    of_scans = streams.flags[rows].reshape(-1, len(kept), streams.flags.shape[1] // len(kept))
    weight = np.hanning(of_scans.shape[-1] + 1)[:-1] ** 2
    return (~of_scans[:, kept]).sum(axis=1) @ (weight / weight.sum())


def cleaned_psd(streams: DrawnBlock, rows: np.ndarray | slice, item: Cleaned, scale: float) -> tuple[int, np.ndarray]:
    """Number of kept scans of a block, and their mean PSD (n_freq,) over the detectors of a pipeline [mK^2/Hz]."""
    power = cleaned_power(streams, rows, item)
    n_sampled = np.maximum(1, sampled_scans(streams, rows, item.kept))
    return int(item.kept.sum()), (power / n_sampled[:, None] * scale).mean(axis=0)


def mean_psd(blocks: list[tuple[int, np.ndarray]]) -> np.ndarray:
    """Average PSDs (n_freq,) of blocks, weighted by their numbers of scans; 0 without a scan."""
    n_scans = max(1, sum(n for n, _ in blocks))
    total: Any = sum(psd * (n / n_scans) for n, psd in blocks)
    return total
