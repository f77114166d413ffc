"""Tests of cleaned time-streams: jumps, glitches, and detectors of outlying noise.

A trouble of one detector leaves a little in the others, because cleaning subtracts what detectors share. A test
therefore takes the detectors that stand out most; the others are tested again after the next cleaning.

A bright source is no trouble. Where at least three passes, each of a detector in a scan, see the same place and agree
that it differs from 0, samples are not tested.
"""

from dataclasses import dataclass

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

    Attributes
    ----------
    data_mk, lost : (n_det, n_samp)
    bounds : (n_scan, 2)
        Scans that cleaning keeps.
    spared : (n_det, n_samp)
        True for samples that are not tested.
    place : (n_det, n_samp)
        Pixel of each sample on a map with a few pixels a beam; -1 for none.
    """

    data_mk: np.ndarray
    lost: np.ndarray
    bounds: np.ndarray
    spared: np.ndarray
    place: np.ndarray

    def used(self) -> np.ndarray:
        """Flags (n_det, n_samp) of the samples within scans that are not lost."""
        return (self.scan_of_sample() >= 0) & ~self.lost

    def scan_of_sample(self) -> np.ndarray:
        """Index (n_samp,) of the scan of each sample; -1 outside."""
        found = np.full(self.data_mk.shape[1], -1)
        for s, (start, stop) in enumerate(self.bounds):
            found[start:stop] = s
        return found


def robust_scatter(values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Standard deviation (n_det,) from the median absolute value over used samples; the plain one where that is 0."""
    found = np.zeros(len(values))
    for d, (row, good) in enumerate(zip(values, used, strict=True)):
        if good.any():
            found[d] = _OF_MEDIAN * np.median(np.abs(row[good])) or np.sqrt(np.mean(row[good].astype(float) ** 2))
    return found


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
    lost, scatter = block.lost, robust_scatter(block.data_mk, block.used())
    for _ in range(_ROUNDS):
        steps = _large_steps(block, lost, window, n_sigma)
        near = np.zeros(lost.shape, bool)
        for (d, s), place in steps.items():
            start, stop = block.bounds[s]
            near[d, max(start, place - window) : min(stop, place + window)] = True
        of_sources = _at_sources(near & ~lost, block, scatter)
        if not of_sources.any():
            break
        lost = lost | of_sources
    found = {}
    for (d, s), place in steps.items():
        height = _confirmed(block, lost, (d, s), place, window)
        if height:
            found[d, s] = f"{height:+.3g} mK"
    return found


def _large_steps(block: CleanedBlock, lost: np.ndarray, window: int, n_sigma: float) -> dict[tuple[int, int], int]:
    """Sample of the largest step, by detector and scan, where it is large enough for a jump."""
    from mapmaker.kernels.cleaned_tests import step_statistic

    step = step_statistic(block.data_mk, lost, block.bounds, window, _FEWEST)
    some = step[:, :: max(1, window // 4)]
    scatter = robust_scatter(some, some != 0)
    found: dict[tuple[int, int], int] = {}
    for s, (start, stop) in enumerate(block.bounds):
        size = np.where(block.spared[:, start:stop], 0, np.abs(step[:, start:stop]))
        most = size.max(axis=1)
        normal = np.median(most[most > 0]) if most.any() else 0.0
        large = (most > n_sigma * scatter) & (most > _AS_ALL * normal) & (most >= _OTHERS * most.max()) & (scatter > 0)
        for d in np.flatnonzero(large):
            found[int(d), s] = int(start + size[d].argmax())
    return found


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
    used = block.used()
    scatter = robust_scatter(block.data_mk, used)
    size = np.where(used & ~block.spared, np.abs(block.data_mk), 0)
    found = (size > n_sigma * scatter[:, None]) & (size >= _OTHERS * size.max(axis=0)) & (scatter[:, None] > 0)
    found &= ~_at_sources(found, block, scatter)
    grown = found.copy()
    for shift in range(1, _MARGIN + 1):
        grown[:, shift:] |= found[:, :-shift]
        grown[:, :-shift] |= found[:, shift:]
    return grown & used


def _at_sources(asked: np.ndarray, block: CleanedBlock, scatter: np.ndarray) -> np.ndarray:
    """Flags (n_det, n_samp) of the used samples that see a source, at the places of the samples that are asked for."""
    n_place = max(block.place.max(), 0) + 2  # the last one for places that are -1
    at_source, of_interest = np.zeros((2, n_place), bool)
    of_interest[block.place[asked]] = True
    of_interest[-1] = False
    if not of_interest.any():
        return np.zeros(asked.shape, bool)
    used = block.used()
    detector, sample = np.nonzero(of_interest[block.place] & used & (scatter[:, None] > 0))
    n_pass = len(scatter) * len(block.bounds)
    of_pass = detector * len(block.bounds) + block.scan_of_sample()[sample]
    keys, member = np.unique(block.place[detector, sample].astype(np.int64) * n_pass + of_pass, return_inverse=True)
    total = np.bincount(member, block.data_mk[detector, sample] / scatter[detector])
    value = total / np.sqrt(np.bincount(member))
    places, first = np.unique(keys // n_pass, return_index=True)
    for place, group in zip(places, np.split(value, first[1:]), strict=True):
        error = _MEDIAN / np.sqrt(len(group))
        at_source[place] = len(group) >= _PASSES and abs(np.median(group)) > _OF_SOURCE * error
    return at_source[block.place] & used


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
