"""Kernels of the PSDs of scans, before and after their Fourier transform, and of streams of given level."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def taper_scans(data, kept, taper, scans):
    """Write the kept scans, less their means and times a taper.

    Parameters
    ----------
    data : (n_det, n_scan * n)
        Scans of n samples side by side.
    kept : (n_scan,)
    taper : (n,)
    scans : (n_det, n_kept, n)
        Output.
    """
    n = taper.size
    for d in range(data.shape[0]):
        place = 0
        for s in range(kept.size):
            if kept[s]:
                row, out = data[d, s * n : (s + 1) * n], scans[d, place]
                total = 0.0
                for i in range(n):
                    total += row[i]
                mean = scans.dtype.type(total / n)
                for i in range(n):
                    out[i] = (row[i] - mean) * taper[i]
                place += 1


@njit(cache=True, nogil=True, fastmath={"contract"})
def add_power(spectrum, total):
    """Add the squares of a spectrum (n_det, n_scan, n_freq) of each scan to `total` (n_det, n_freq) float64."""
    for d in range(spectrum.shape[0]):
        power = total[d]
        for s in range(spectrum.shape[1]):
            row = spectrum[d, s]
            for k in range(row.size):
                power[k] += row[k].real * row[k].real + row[k].imag * row[k].imag


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def scale_mean_removed(data, n_scans, level):
    """Subtract the mean of each of equal scans from data (n_det, n_samp) and multiply by `level` (n_det,), in place."""
    n = data.shape[1] // n_scans
    for d in range(data.shape[0]):
        for s in range(n_scans):
            row = data[d, s * n : (s + 1) * n]
            total = 0.0
            for i in range(n):
                total += row[i]
            mean = level.dtype.type(total / n)
            for i in range(n):
                row[i] = level[d] * (row[i] - mean)
