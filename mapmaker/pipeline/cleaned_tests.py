"""Tests of cleaned time-streams: jumps, glitches, and detectors of outlying noise.

A trouble of one detector leaves a little in the others, because cleaning subtracts what detectors share. A test
therefore takes the detectors that stand out most; the others are tested again after the next cleaning.

A bright source is no trouble. Where at least three passes, each of a detector in a scan, see the same place and agree
that it differs from 0, samples are not tested.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

_OF_MEDIAN = 1.482602218505602  # standard deviation of a normal deviate over its median absolute value
_OTHERS = 0.5  # a trouble below this fraction of the largest at the same time may be an echo of it
_AS_ALL = 2.5  # a jump is larger than the median over detectors of the largest step in the scan by this factor
_FEWEST = 4  # samples before and after a jump
_MARGIN = 1  # samples flagged before and after a glitch
_OF_SOURCE = 5.0  # significance of the median over passes, from which on they see a source
_PASSES = 3  # fewest passes for that
_ROUNDS = 4  # of the search for jumps, each without the sources that the one before found
_MEDIAN = 1.2533141373155003  # standard deviation of the median of normal deviates, over that of their mean


@dataclass(frozen=True)
class CleanedBlock:
    """Cleaned time-streams to test.

    Tests go from detector to detector: arrays for all samples of all detectors would be several times the streams.

    Attributes
    ----------
    data_mk, lost : (n_det, n_samp)
    bounds : (n_scan, 2)
        Scans that cleaning keeps, in order.
    spared
        Function of a detector's row: flags (n_samp,), True for samples that are not tested.
    place
        Function of a detector's row: pixels (n_samp,) on a map with a few pixels a beam, -1 for none.
    n_place
        Pixels of that map.
    """

    data_mk: np.ndarray
    lost: np.ndarray
    bounds: np.ndarray
    spared: Callable[[int], np.ndarray]
    place: Callable[[int], np.ndarray]
    n_place: int

    @cached_property
    def scan_of_sample(self) -> np.ndarray:
        """Index (n_samp,) of the scan of each sample; -1 outside."""
        found = np.full(self.data_mk.shape[1], -1)
        for s, (start, stop) in enumerate(self.bounds):
            found[start:stop] = s
        return found

    def used(self, d: int) -> np.ndarray:
        """Flags (n_samp,) of the samples of a detector within scans that are not lost."""
        return (self.scan_of_sample >= 0) & ~self.lost[d]

    @cached_property
    def scatter(self) -> np.ndarray:
        """Robust scatter (n_det,) of the used samples."""
        return np.array([robust_scatter(row[self.used(d)]) for d, row in enumerate(self.data_mk)])


def robust_scatter(values: np.ndarray) -> float:
    """Standard deviation from the median absolute value; the plain one where that is 0, and 0 without a value."""
    if not len(values):
        return 0.0
    return float(_OF_MEDIAN * np.median(np.abs(values)) or np.sqrt(np.mean(values.astype(float) ** 2)))


def find_jumps(block: CleanedBlock, window: int, n_sigma: float) -> dict[tuple[int, int], str]:
    """Find detectors with a jump in a scan.

    The statistic is the difference of the means over `window` samples after and before a sample, or fewer up to the
    end of the scan, divided by its standard deviation for white noise of 1 mK. Its scatter over the scans is robust,
    and contains slow noise. The difference of the medians must confirm a jump, which glitches don't pass.

    Returns
    -------
    dict
        Height of the jump as a text, by detector and scan.
    """
    lost = block.lost
    for _ in range(_ROUNDS):
        steps = _large_steps(block, lost, window, n_sigma)
        asked = np.zeros(block.n_place + 1, bool)
        for (d, s), place in steps.items():
            start, stop = block.bounds[s]
            near = slice(max(start, place - window), min(stop, place + window))
            asked[block.place(d)[near][~lost[d, near]]] = True
        sources = _sources(asked, block)
        if not sources.any():
            break
        lost = np.array([row | _at_sources(sources, block, d) for d, row in enumerate(lost)])
    found = {}
    for (d, s), place in steps.items():
        height = _confirmed(block, lost, (d, s), place, window)
        if height:
            found[d, s] = f"{height:+.3g} mK"
    return found


def _large_steps(block: CleanedBlock, lost: np.ndarray, window: int, n_sigma: float) -> dict[tuple[int, int], int]:
    """Sample of the largest step, by detector and scan, where it is large enough for a jump."""
    shape = len(block.data_mk), len(block.bounds)
    most, scatter = np.zeros(shape), np.zeros(shape[0])
    for d in range(shape[0]):
        step = _steps(block, lost, d, window)
        some = step[:: max(1, window // 4)]
        scatter[d] = robust_scatter(some[some != 0])
        size = np.append(np.where(block.spared(d), 0, np.abs(step)), 0)
        most[d] = np.maximum.reduceat(size, block.bounds.ravel())[::2] if shape[1] else 0
    normal = np.array([np.median(column[column > 0]) if column.any() else 0.0 for column in most.T])
    large = (most > n_sigma * scatter[:, None]) & (most > _AS_ALL * normal) & (scatter[:, None] > 0)
    large &= most >= _OTHERS * most.max(axis=0, initial=0)
    found: dict[tuple[int, int], int] = {}
    for d in np.flatnonzero(large.any(axis=1)).tolist():
        size = np.where(block.spared(d), 0, np.abs(_steps(block, lost, d, window)))
        for s in np.flatnonzero(large[d]).tolist():
            start, stop = block.bounds[s]
            found[d, s] = int(start + size[start:stop].argmax())
    return found


def _steps(block: CleanedBlock, lost: np.ndarray, d: int, window: int) -> np.ndarray:
    """Statistic (n_samp,) of the steps of a detector."""
    from mapmaker.kernels.cleaned_tests import step_statistic

    row = slice(d, d + 1)
    return step_statistic(block.data_mk[row], lost[row], block.bounds, window, _FEWEST)[0]


def _confirmed(block: CleanedBlock, lost: np.ndarray, at: tuple[int, int], place: int, window: int) -> float:
    """Difference of the medians after and before a place [mK]; 0 if it is below half of the difference of the means."""
    d, s = at
    start, stop = block.bounds[s]
    sides = slice(max(start, place - window), place), slice(place, min(stop, place + window))
    values = [block.data_mk[d, side][~lost[d, side]].astype(float) for side in sides]
    if min(map(len, values)) < _FEWEST:
        return 0.0
    height = float(np.median(values[1]) - np.median(values[0]))
    return height if abs(height) > 0.5 * abs(values[1].mean() - values[0].mean()) else 0.0


def find_glitches(block: CleanedBlock, n_sigma: float) -> np.ndarray:
    """Find glitches: samples far from 0, with their neighbours.

    Returns
    -------
    (n_det, n_samp) bool array
        Samples that are lost by this.
    """
    largest = np.zeros(block.data_mk.shape[1], block.data_mk.dtype)
    for d in range(len(block.data_mk)):
        np.maximum(largest, _sizes(block, d), out=largest)
    found, asked = np.zeros(block.lost.shape, bool), np.zeros(block.n_place + 1, bool)
    for d, row in enumerate(found):
        size = _sizes(block, d)
        row[:] = (size > n_sigma * block.scatter[d]) & (size >= _OTHERS * largest) & (block.scatter[d] > 0)
        if row.any():
            asked[block.place(d)[row]] = True
    sources = _sources(asked, block)
    for d in np.flatnonzero(found.any(axis=1)).tolist():
        row = found[d] & ~_at_sources(sources, block, d)
        found[d] = np.convolve(row, np.ones(2 * _MARGIN + 1, bool), "same").astype(bool) & block.used(d)
    return found


def _sizes(block: CleanedBlock, d: int) -> np.ndarray:
    """Absolute values (n_samp,) of a detector; 0 where it is not tested."""
    return np.where(block.used(d) & ~block.spared(d), np.abs(block.data_mk[d]), 0)


def _at_sources(sources: np.ndarray, block: CleanedBlock, d: int) -> np.ndarray:
    """Flags (n_samp,) of the used samples of a detector that see a source, of flags (n_place + 1,) of places."""
    if not sources.any():
        return np.zeros(block.data_mk.shape[1], bool)
    return sources[block.place(d)] & block.used(d)


def _sources(asked: np.ndarray, block: CleanedBlock) -> np.ndarray:
    """Flags (n_place + 1,) of the places that have a source, of those asked for; the last one is that of places -1."""
    sources, asked = np.zeros(len(asked), bool), asked & (np.arange(len(asked)) < block.n_place)
    if not asked.any():
        return sources
    n_scan, seen = len(block.bounds), []
    for d in np.flatnonzero(block.scatter > 0).tolist():
        place = block.place(d)
        samples = np.flatnonzero(asked[place] & block.used(d))
        passes, member = np.unique(
            place[samples] * np.int64(n_scan) + block.scan_of_sample[samples], return_inverse=True
        )
        total = np.bincount(member, block.data_mk[d, samples] / block.scatter[d])
        seen.append((passes // n_scan, total / np.sqrt(np.bincount(member))))
    at, value = (np.concatenate(columns) for columns in zip(*seen, strict=True))
    order = np.argsort(at, kind="stable")
    places, first = np.unique(at[order], return_index=True)
    for place, group in zip(places, np.split(value[order], first[1:]), strict=True):
        error = _MEDIAN / np.sqrt(len(group))
        sources[place] = len(group) >= _PASSES and abs(np.median(group)) > _OF_SOURCE * error
    return sources


def white_noise(data_mk: np.ndarray, lost: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """White noise (n_det,) [mK a sample] from differences of neighbouring samples; 0 without any."""
    square, count = np.zeros(len(data_mk)), np.zeros(len(data_mk))
    for start, stop in bounds:
        good = ~(lost[:, start + 1 : stop] | lost[:, start : stop - 1])
        step = np.where(good, np.diff(data_mk[:, start:stop].astype(float), axis=1), 0)
        square += np.einsum("in,in->i", step, step)
        count += good.sum(axis=1)
    return np.sqrt(square / np.maximum(1, 2 * count))


def mean_square(data_mk: np.ndarray, lost: np.ndarray, bounds: np.ndarray) -> np.ndarray:
    """Mean square (n_det,) [mK^2] of the samples within scans that are not lost; 0 without any."""
    square, count = np.zeros(len(data_mk)), np.zeros(len(data_mk))
    for start, stop in bounds:
        good = ~lost[:, start:stop]
        block = np.where(good, data_mk[:, start:stop].astype(float), 0)
        square += np.einsum("in,in->i", block, block)
        count += good.sum(axis=1)
    return square / np.maximum(1, count)
