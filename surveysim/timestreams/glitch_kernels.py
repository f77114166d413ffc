"""Kernel of the glitches in time-streams."""

from mapmaker.kernels.compiled import njit

_LEAST = 1e-6  # of its amplitude, at which a glitch ends


@njit(cache=True, nogil=True)
def add_pulses(data, per_scan, detector, scan, start, amplitude, decay):
    """Add pulses (n_pulse,) that decay by the factor `decay` a sample to data (n_det, n_samp), each in its scan.

    `start` counts from the first of the `per_scan` samples of the scan, and is negative before it.
    """
    for k in range(detector.size):
        row = data[detector[k], scan[k] * per_scan : (scan[k] + 1) * per_scan]
        value, n = amplitude[k], start[k]
        if n < 0:
            value *= decay**-n
            n = 0
        while n < per_scan and value > _LEAST * amplitude[k]:
            row[n] += value
            value *= decay
            n += 1
