"""Tests of cleaned time-streams: jumps, glitches, and detectors of outlying noise.

A trouble of one detector leaves a little in the others, because cleaning subtracts what detectors share. A test
therefore takes the detectors that stand out most; the others are tested again after the next cleaning.
"""

import numpy as np

_OF_MEDIAN = 1.482602218505602  # standard deviation of a normal deviate over its median absolute value
_OTHERS = 0.5  # a trouble below this fraction of the largest at the same time may be an echo of it
_AS_ALL = 2.5  # a jump is larger than the median over detectors of the largest step in the scan by this factor
_FEWEST = 4  # samples before and after a jump
_MARGIN = 1  # samples flagged before and after a glitch
_OF_SOURCE = 5.0  # significance of the median of the samples at one place, from which on they see a source
_AT_PLACE = 4  # fewest samples for that
_MEDIAN = 1.2533141373155003  # standard deviation of the median of normal deviates, over that of their mean


def robust_scatter(values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """Standard deviation (n_det,) from the median absolute value over used samples; the plain one where that is 0."""
    found = np.zeros(len(values))
    for d, (row, good) in enumerate(zip(values, used, strict=True)):
        if good.any():
            found[d] = _OF_MEDIAN * np.median(np.abs(row[good])) or np.sqrt(np.mean(row[good].astype(float) ** 2))
    return found


def find_jumps(
    data_mk: np.ndarray, lost: np.ndarray, bounds: np.ndarray, *, window: int, n_sigma: float, spared: np.ndarray
) -> dict[tuple[int, int], str]:
    """Find detectors with a jump in a scan.

    The statistic is the difference of the means over `window` samples after and before a sample, or fewer up to the
    end of the scan, divided by its standard deviation for white noise of 1 mK. Its scatter over the scans is robust,
    and contains slow noise. The difference of the medians must confirm a jump, which glitches and sources don't pass.

    Parameters
    ----------
    data_mk, lost : (n_det, n_samp)
    bounds : (n_scan, 2)
    window
    n_sigma
    spared : (n_det, n_samp)
        True for samples that are not tested.

    Returns
    -------
    dict
        Height of the jump as a text, by detector and scan.
    """
    from mapmaker.kernels.cleaned_tests import step_statistic

    step = step_statistic(data_mk, lost, bounds, window, _FEWEST)
    scatter = robust_scatter(step[:, :: max(1, window // 4)], step[:, :: max(1, window // 4)] != 0)
    found: dict[tuple[int, int], str] = {}
    for s, (start, stop) in enumerate(bounds):
        size = np.where(spared[:, start:stop], 0, np.abs(step[:, start:stop]))
        place, most = size.argmax(axis=1), size.max(axis=1)
        normal = np.median(most[most > 0]) if most.any() else 0.0
        large = (most > n_sigma * scatter) & (most > _AS_ALL * normal) & (most >= _OTHERS * most.max()) & (scatter > 0)
        for d in np.flatnonzero(large):
            height, least = _confirmed(data_mk[d, start:stop], lost[d, start:stop], int(place[d]), window)
            if abs(height) > least:
                found[int(d), s] = f"{height:+.3g} mK"
    return found


def _confirmed(row: np.ndarray, lost: np.ndarray, place: int, window: int) -> tuple[float, float]:
    """Difference of the medians after and before a place, and half of the difference of the means."""
    sides = [slice(max(0, place - window), place), slice(place, place + window)]
    values = [row[side][~lost[side]].astype(float) for side in sides]
    height = np.median(values[1]) - np.median(values[0])
    return float(height), 0.5 * abs(float(values[1].mean() - values[0].mean()))


def find_glitches(
    data_mk: np.ndarray,
    lost: np.ndarray,
    bounds: np.ndarray,
    *,
    n_sigma: float,
    spared: np.ndarray,
    place: np.ndarray,
) -> np.ndarray:
    """Find glitches: samples far from 0, with their neighbours.

    Samples of one place on the sky whose median differs from 0 see a source: they are no glitches.

    Parameters
    ----------
    data_mk, lost, bounds, spared
        As for `find_jumps`.
    n_sigma
    place : (n_det, n_samp)
        Pixel of each sample on a map with a few pixels a beam; -1 for none.

    Returns
    -------
    (n_det, n_samp) bool array
        Samples that are lost by this.
    """
    inside = np.zeros(data_mk.shape[1], bool)
    for start, stop in bounds:
        inside[start:stop] = True
    used = inside & ~lost
    scatter = robust_scatter(data_mk, used)
    size = np.where(used & ~spared, np.abs(data_mk), 0)
    found = (size > n_sigma * scatter[:, None]) & (size >= _OTHERS * size.max(axis=0)) & (scatter[:, None] > 0)
    found &= ~_of_sources(found, data_mk, used, scatter, place)
    grown = found.copy()
    for shift in range(1, _MARGIN + 1):
        grown[:, shift:] |= found[:, :-shift]
        grown[:, :-shift] |= found[:, shift:]
    return grown & used


def _of_sources(
    found: np.ndarray, data_mk: np.ndarray, used: np.ndarray, scatter: np.ndarray, place: np.ndarray
) -> np.ndarray:
    """Flags (n_det, n_samp) of the samples that are at the place of a source."""
    pixels = np.unique(place[found])
    pixels = pixels[pixels >= 0]
    at_source = np.zeros(max(place.max(), 0) + 2, bool)  # the last one for places that are -1
    if not len(pixels):
        return at_source[place]
    asked = at_source.copy()
    asked[pixels] = True
    detector, sample = np.nonzero(asked[place] & used & (scatter[:, None] > 0))
    values, order = data_mk[detector, sample] / scatter[detector], np.argsort(place[detector, sample], kind="stable")
    at, first = np.unique(place[detector, sample][order], return_index=True)
    for pixel, group in zip(at, np.split(values[order], first[1:]), strict=True):
        error = _MEDIAN / np.sqrt(len(group))
        at_source[pixel] = len(group) >= _AT_PLACE and abs(np.median(group)) > _OF_SOURCE * error
    return at_source[place]


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
