"""Kernels of the tests of cleaned time-streams."""

import numpy as np

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def step_statistic(data, lost, bounds, window, fewest):
    """Difference of the means after and before each sample, over its standard deviation in white noise of 1.

    Parameters
    ----------
    data, lost : (n_det, n_samp)
    bounds : (n_scan, 2)
    window
        Most samples on each side.
    fewest
        Fewest good samples on each side.

    Returns
    -------
    (n_det, n_samp) array
        float32; 0 where there are too few samples, and outside scans.
    """
    found = np.zeros(data.shape, np.float32)
    for d in range(data.shape[0]):
        for s in range(bounds.shape[0]):
            start, stop = bounds[s, 0], bounds[s, 1]
            before, after, n_before, n_after = 0.0, 0.0, 0, 0
            for n in range(start, min(stop, start + window)):
                if not lost[d, n]:
                    after += data[d, n]
                    n_after += 1
            for n in range(start, stop):
                if min(n_before, n_after) >= fewest:
                    scale = np.sqrt(1.0 / n_before + 1.0 / n_after)
                    found[d, n] = (after / n_after - before / n_before) / scale
                if not lost[d, n]:
                    before += data[d, n]
                    after -= data[d, n]
                    n_before += 1
                    n_after -= 1
                if n - window >= start and not lost[d, n - window]:
                    before -= data[d, n - window]
                    n_before -= 1
                if n + window < stop and not lost[d, n + window]:
                    after += data[d, n + window]
                    n_after += 1
    return found
