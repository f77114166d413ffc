"""Kernels of the detectors' response in time, and of its deconvolution."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def low_pass(data, per_scan, decay, taps):
    """Filter every scan of every detector with one pole, in place.

    Parameters
    ----------
    data : (n_det, n_samp)
        Whole scans side by side.
    per_scan
        Samples of a scan.
    decay, taps : (n_det,), (n_det, 4)
        Coefficients of ``y[n] = decay y[n-1] + sum_j taps[j] x[n-2+j]``. A scan starts with ``y[0] = x[0]``, and its
        first and last samples continue beyond its ends.
    """
    for d in range(data.shape[0]):
        a, t0, t1, t2, t3 = decay[d], taps[d, 0], taps[d, 1], taps[d, 2], taps[d, 3]
        for start in range(0, data.shape[1], per_scan):
            y = float(data[d, start])
            before, last, now = y, y, float(data[d, start + 1])
            for n in range(start + 1, start + per_scan):
                after = float(data[d, n + 1]) if n + 1 < start + per_scan else now
                y = a * y + t0 * before + t1 * last + t2 * now + t3 * after
                before, last, now = last, now, after
                data[d, n] = y


@njit(cache=True, nogil=True)
def add_derivative(data, per_scan, lead):
    """Add a multiple of its derivative to every scan of every detector, in place.

    Parameters
    ----------
    data : (n_det, n_samp)
        Whole scans side by side.
    per_scan
        Samples of a scan.
    lead : (n_det,)
        Multiple of the derivative by sample, ``(y[n-2] - 8 y[n-1] + 8 y[n+1] - y[n+2]) / 12``. The first and last
        samples of a scan continue beyond its ends.
    """
    for d in range(data.shape[0]):
        scale = lead[d] / 12
        for start in range(0, data.shape[1], per_scan):
            last = start + per_scan - 1
            now = float(data[d, start])
            far, near = now, now
            for n in range(start, start + per_scan):
                ahead, further = float(data[d, min(n + 1, last)]), float(data[d, min(n + 2, last)])
                data[d, n] = now + scale * (far - 8 * near + 8 * ahead - further)
                far, near, now = near, now, ahead
