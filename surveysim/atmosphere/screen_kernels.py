"""Kernels of the atmospheric screen: Fourier modes of a strip, and look-up along detector tracks."""

import numpy as np

from mapmaker.kernels.compiled import njit

# Samples of a detector whose places are computed before the look-up: loops without look-ups are vector instructions.
AT_ONCE = 512


@njit(cache=True, nogil=True)
def combine_columns(columns, start, normals, modes):
    """Sum the factors of every frequency with the random amplitudes of some strips.

    Parameters
    ----------
    columns : (n_total, n_lane or more)
    start : (n_freq + 1,)
    normals : (n_strip, 2 n_total or more)
        Real and imaginary parts in turn.
    modes : (n_strip, n_lane, n_freq or more)
        Complex output.
    """
    n_strip, n_lane, n_freq = modes.shape[0], modes.shape[1], start.size - 1
    real = np.empty((n_strip, columns.shape[1]), columns.dtype)
    imag = np.empty((n_strip, columns.shape[1]), columns.dtype)
    for k in range(n_freq):
        real[:] = 0.0
        imag[:] = 0.0
        for r in range(start[k], start[k + 1]):
            column = columns[r]
            for s in range(n_strip):  # their sums do not wait for each other
                a, b, of_a, of_b = normals[s, 2 * r], normals[s, 2 * r + 1], real[s], imag[s]
                for lane in range(column.size):
                    of_a[lane] += a * column[lane]
                    of_b[lane] += b * column[lane]
        for s in range(n_strip):
            for lane in range(n_lane):
                modes[s, lane, k] = complex(real[s, lane], imag[s, lane])


@njit(cache=True, nogil=True)
def _check_inside(data, start, stop, strip, x0, y0, dx):
    """Raise IndexError for samples or detectors outside the data, ValueError when a track leaves the strip."""
    n_lane, n_x = strip.shape
    if not (0 <= start < stop <= data.shape[1] and x0.size == data.shape[0] and y0.size == data.shape[0]):
        raise IndexError("samples or detectors outside the data")
    for d in range(data.shape[0]):
        last = x0[d] + (stop - start - 1) * dx
        # Written so that NaN fails too.
        if not (dx >= 0.0 and x0[d] >= 0.0 and last <= n_x - 1 and y0[d] >= 0.0 and y0[d] <= n_lane - 1):
            raise ValueError("a detector's track leaves the strip")


@njit(cache=True, nogil=True)
def add_screen(data, start, stop, strip, x0, y0, dx, amplitude):
    """Add bilinear look-ups in a strip to the samples start:stop of every detector.

    Detector d is at x0[d] + n dx along the strip and at the lane coordinate y0[d], with n counted from `start`.

    Parameters
    ----------
    data : (n_det, n_samp)
        Changed in place.
    start, stop
    strip : (n_lane, n_x)
        Both sides at least 2.
    x0, y0 : (n_det,)
        In lattice steps.
    dx
        In lattice steps, at least 0.
    amplitude

    Raises
    ------
    IndexError
        For samples or detectors outside the data.
    ValueError
        Where a track leaves the strip.
    """
    _check_inside(data, start, stop, strip, x0, y0, dx)
    n_lane, n_x = strip.shape
    n_samp = stop - start
    row = np.empty(n_x + 1, strip.dtype)
    cell, part = np.empty(AT_ONCE, np.int32), np.empty(AT_ONCE, strip.dtype)
    for d in range(data.shape[0]):
        last = x0[d] + (n_samp - 1) * dx
        lane = min(int(y0[d]), n_lane - 2)
        upper = strip.dtype.type(amplitude * (y0[d] - lane))
        lower = strip.dtype.type(amplitude * (1.0 - (y0[d] - lane)))
        first = int(x0[d])
        n_cell = min(int(last) + 2, n_x) - first
        near, far = strip[lane, first : first + n_cell], strip[lane + 1, first : first + n_cell]
        for m in range(n_cell):
            row[m] = lower * near[m] + upper * far[m]
        # A last sample that rounds up to the end has zero weight here.
        row[n_cell] = row[n_cell - 1]
        x_first = x0[d] - first
        for begin in range(0, n_samp, AT_ONCE):
            samples = data[d, start + begin : min(start + begin + AT_ONCE, stop)]
            for n in range(samples.size):
                x = x_first + (begin + n) * dx
                cell[n] = np.int32(x)
                part[n] = x - cell[n]
            for n in range(samples.size):
                # Unsigned, which avoids numba's check for negative indices.
                m = np.uint64(cell[n])
                samples[n] += row[m] + part[n] * (row[m + np.uint64(1)] - row[m])


@njit(cache=True, nogil=True)
def add_weighted(data, start, values, weight):
    """Add values (n_det, n) times the weight (n,) of each sample to the samples of every detector from `start` on."""
    if not (0 <= start <= data.shape[1] - values.shape[1] and values.shape[0] == data.shape[0]):
        raise IndexError("samples or detectors outside the data")
    if weight.size != values.shape[1]:
        raise IndexError("one weight for each sample is needed")
    own = weight.astype(values.dtype)
    for d in range(values.shape[0]):
        samples, of_detector = data[d, start : start + values.shape[1]], values[d]
        for n in range(own.size):
            samples[n] += own[n] * of_detector[n]


@njit(cache=True, nogil=True)
def add_screen_nearest(data, start, stop, strip, x0, y0, dx, amplitude):
    """As `add_screen`, with the nearest lattice point, the higher one for ties."""
    _check_inside(data, start, stop, strip, x0, y0, dx)
    for d in range(data.shape[0]):
        row = strip[int(y0[d] + 0.5)]
        for n in range(stop - start):
            data[d, start + n] += strip.dtype.type(amplitude) * row[int(x0[d] + n * dx + 0.5)]


@njit(cache=True, nogil=True)
def add_screen_cubic(data, start, stop, strip, x0, y0, dx, amplitude):
    """As `add_screen`, with the cubic through the four nearest points in both directions.

    Near an edge the four outermost points are used. The strip has at least 4 lanes and points, or else IndexError is
    raised.
    """
    _check_inside(data, start, stop, strip, x0, y0, dx)
    n_lane, n_x = strip.shape
    if n_lane < 4 or n_x < 4:
        raise IndexError("a strip of four lanes and points or more is needed")
    row = np.empty(n_x, strip.dtype)
    weight = np.empty(4, strip.dtype)
    for d in range(data.shape[0]):
        lane = min(max(int(y0[d]) - 1, 0), n_lane - 4)
        cubic_weights(y0[d] - lane, weight)
        first = min(max(int(x0[d]) - 1, 0), n_x - 4)
        beyond = min(int(x0[d] + (stop - start - 1) * dx) + 3, n_x)
        for m in range(first, max(beyond, first + 4)):
            value = weight[0] * strip[lane, m] + weight[1] * strip[lane + 1, m]
            row[m] = value + weight[2] * strip[lane + 2, m] + weight[3] * strip[lane + 3, m]
        for n in range(stop - start):
            x = x0[d] + n * dx
            m = min(max(int(x) - 1, 0), n_x - 4)
            cubic_weights(x - m, weight)
            value = weight[0] * row[m] + weight[1] * row[m + 1] + weight[2] * row[m + 2] + weight[3] * row[m + 3]
            data[d, start + n] += strip.dtype.type(amplitude) * value


@njit(cache=True, nogil=True)
def cubic_weights(x, weight):
    """Write the Lagrange weights (4,) of the values at 0, 1, 2 and 3 for the position x; exact for cubics."""
    a, b, c, d = x, x - 1.0, x - 2.0, x - 3.0
    weight[0] = -b * c * d / 6.0
    weight[1] = a * c * d / 2.0
    weight[2] = -a * b * d / 2.0
    weight[3] = a * b * c / 6.0
