"""Kernels that fill gaps in time-streams, and flag runs of samples."""

import numpy as np

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def fill_gaps(data, bounds, lost):
    """Fill the lost samples of each scan as `mapmaker.lost_samples.fill_flagged`, in place.

    Parameters
    ----------
    data, lost : (n_det, n_samp)
    bounds : (n_scan, 2)
    """
    for s in range(bounds.shape[0]):
        start, stop = bounds[s, 0], bounds[s, 1]
        if lost[:, start:stop].any():
            common = _common(data, lost, start, stop)
            for d in range(data.shape[0]):
                _fill(data[d, start:stop], lost[d, start:stop], common)


@njit(cache=True, nogil=True)
def _common(data, lost, start, stop):
    """Sum of the mean changes from one time with a sample to the next, interpolated between; NaN without a sample."""
    n_samp = stop - start
    change, count, seen = np.zeros(n_samp), np.zeros(n_samp), np.zeros(n_samp, np.bool_)
    for d in range(data.shape[0]):
        gone = lost[d, start:stop]
        for n in range(n_samp):
            seen[n] |= not gone[n]
    times = np.flatnonzero(seen)
    if times.size == 0:
        return np.full(n_samp, np.nan)
    for d in range(data.shape[0]):
        row, gone = data[d, start:stop], lost[d, start:stop]
        for k in range(1, times.size):
            n, before = times[k], times[k - 1]
            if not (gone[n] or gone[before]):
                change[k] += row[n] - row[before]
                count[k] += 1
    for k in range(1, times.size):
        change[k] = change[k - 1] + change[k] / max(1, count[k])
    return np.interp(np.arange(n_samp), times, change[: times.size])


@njit(cache=True, nogil=True)
def _side(row, gone, common, first, step, most):
    """Mean over up to `most` samples from `first` on, until the next gap, less the common signal; their mean place."""
    total, place, count, n = 0.0, 0.0, 0, first
    while 0 <= n < row.size and not gone[n] and count < most:
        total += row[n] - common[n]
        place += n
        count += 1
        n += step
    return (total / count, place / count) if count else (0.0, -1.0)


@njit(cache=True, nogil=True)
def _fill(row, gone, common):
    """Fill the gaps of one detector in one scan."""
    first = 0
    while first < row.size:
        if not gone[first]:
            first += 1
            continue
        end = first
        while end < row.size and gone[end]:
            end += 1
        left, before = _side(row, gone, common, first - 1, -1, end - first)
        right, after = _side(row, gone, common, end, 1, end - first)
        if before < 0.0:
            left, before = right, after - 1.0
        if after < 0.0:
            right, after = left, before + 1.0
        for k in range(first, end):
            row[k] = common[k] + left + (right - left) * (k - before) / (after - before)
        first = end


@njit(cache=True, nogil=True)
def flag_runs(lost, detector, start, stop):
    """Flag the samples `start` to `stop - 1` of a detector for each of some runs (n_run,), in place."""
    for k in range(detector.size):
        lost[detector[k], start[k] : stop[k]] = True
