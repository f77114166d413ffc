"""Kernel of the detectors' response in time."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def low_pass(data, per_scan, decay, now, before):
    """Filter every scan of every detector with one pole, in place.

    Parameters
    ----------
    data : (n_det, n_samp)
        Whole scans side by side.
    per_scan
        Samples of a scan.
    decay, now, before : (n_det,)
        Coefficients of ``y[n] = decay y[n-1] + now x[n] + before x[n-1]``. A scan starts with ``y[0] = x[0]``.
    """
    for d in range(data.shape[0]):
        a, b, c = decay[d], now[d], before[d]
        for start in range(0, data.shape[1], per_scan):
            last = float(data[d, start])
            y = last
            for n in range(start + 1, start + per_scan):
                x = float(data[d, n])
                y = a * y + b * x + c * last
                last = x
                data[d, n] = y
