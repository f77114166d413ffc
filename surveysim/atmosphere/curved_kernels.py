"""Kernels of the atmospheric screen: look-up in a strip along curved detector tracks.

The boresight moves freely over the strip, and the offsets of the detectors turn about it. In lattice steps, detector d
is in sample n at

    x = x_n + cosine_n u_d - sine_n v_d,    y = y_n - sine_n u_d - cosine_n v_d,

with its offset (u, v) in azimuth (on the sky) and elevation: the plane of the layer, seen from below, is a mirror image
of the sky.
"""

import numpy as np

from mapmaker.kernels.compiled import njit
from surveysim.atmosphere.screen_kernels import AT_ONCE, cubic_weights

# Rounding [lattice steps] that is allowed at the edges of a strip.
_ROUNDING = 1e-6


@njit(cache=True, nogil=True)
def _check_inside(data, start, stop, strip, x, y, cosine, sine, amplitude, u, v):
    """Raise IndexError for samples or detectors outside the data, ValueError where a track may leave the strip."""
    n_lane, n_x = strip.shape
    n, n_det = stop - start, data.shape[0]
    if not (0 <= start < stop <= data.shape[1] and u.size == n_det and v.size == n_det):
        raise IndexError("samples or detectors outside the data")
    if not (x.size == n and y.size == n and cosine.size == n and sine.size == n and amplitude.size == n):
        raise IndexError("samples or detectors outside the data")
    radius = 0.0
    for d in range(n_det):
        radius = max(radius, np.hypot(u[d], v[d]) if np.isfinite(u[d] + v[d]) else np.inf)
    for i in range(n):
        reach = radius * np.hypot(cosine[i], sine[i]) - _ROUNDING
        # Written so that NaN fails too.
        if not (x[i] >= reach and x[i] + reach <= n_x - 1 and y[i] >= reach and y[i] + reach <= n_lane - 1):
            raise ValueError("a detector's track leaves the strip")


@njit(cache=True, nogil=True)
def add_curved(data, start, stop, strip, x, y, cosine, sine, amplitude, u, v):
    """Add bilinear look-ups in a strip to the samples start:stop of every detector.

    Parameters
    ----------
    data : (n_det, n_samp)
        Changed in place.
    start, stop
    strip : (n_lane, n_x)
        Both sides at least 2; contiguous.
    x, y : (stop - start,)
        Boresight, in lattice steps.
    cosine, sine : (stop - start,)
        Turn of the offsets.
    amplitude : (stop - start,)
    u, v : (n_det,)
        Offsets, in lattice steps.

    Raises
    ------
    IndexError
        For samples or detectors outside the data.
    ValueError
        Where a track leaves the strip, or may with another camera of the same radius.
    """
    _check_inside(data, start, stop, strip, x, y, cosine, sine, amplitude, u, v)
    n_lane, n_x = strip.shape
    values, factor = strip.reshape(-1), amplitude.astype(strip.dtype)
    cell, last_cell, last_lane, width = (
        np.empty(AT_ONCE, np.int32),
        np.int32(n_x - 2),
        np.int32(n_lane - 2),
        np.int32(n_x),
    )
    along, across = np.empty(AT_ONCE, strip.dtype), np.empty(AT_ONCE, strip.dtype)
    for d in range(data.shape[0]):
        a, b = u[d], v[d]
        for begin in range(0, stop - start, AT_ONCE):
            end = min(begin + AT_ONCE, stop - start)
            samples, factors = data[d, start + begin : start + end], factor[begin:end]
            xs, ys, cosines, sines = x[begin:end], y[begin:end], cosine[begin:end], sine[begin:end]
            for n in range(samples.size):  # a loop without look-ups, compiled to vector instructions
                px = xs[n] + cosines[n] * a - sines[n] * b
                py = ys[n] - sines[n] * a - cosines[n] * b
                i, j = min(np.int32(px), last_cell), min(np.int32(py), last_lane)
                along[n] = px - i
                across[n] = py - j
                cell[n] = j * width + i
            for n in range(samples.size):
                # Unsigned, which avoids numba's check for negative indices.
                k = np.uint64(cell[n])
                above = k + np.uint64(n_x)
                near = values[k] + along[n] * (values[k + np.uint64(1)] - values[k])
                far = values[above] + along[n] * (values[above + np.uint64(1)] - values[above])
                samples[n] += factors[n] * (near + across[n] * (far - near))


@njit(cache=True, nogil=True)
def add_curved_nearest(data, start, stop, strip, x, y, cosine, sine, amplitude, u, v):
    """As `add_curved`, with the nearest lattice point, the higher one for ties."""
    _check_inside(data, start, stop, strip, x, y, cosine, sine, amplitude, u, v)
    for d in range(data.shape[0]):
        for n in range(stop - start):
            i = int(x[n] + cosine[n] * u[d] - sine[n] * v[d] + 0.5)
            j = int(y[n] - sine[n] * u[d] - cosine[n] * v[d] + 0.5)
            data[d, start + n] += strip.dtype.type(amplitude[n]) * strip[j, i]


@njit(cache=True, nogil=True)
def add_curved_cubic(data, start, stop, strip, x, y, cosine, sine, amplitude, u, v):
    """As `add_curved`, with the cubic through the four nearest points in both directions.

    Near an edge the four outermost points are used. The strip has at least 4 lanes and points, or else IndexError is
    raised.
    """
    _check_inside(data, start, stop, strip, x, y, cosine, sine, amplitude, u, v)
    n_lane, n_x = strip.shape
    if n_lane < 4 or n_x < 4:
        raise IndexError("a strip of four lanes and points or more is needed")
    along, across = np.empty(4, strip.dtype), np.empty(4, strip.dtype)
    for d in range(data.shape[0]):
        for n in range(stop - start):
            px = x[n] + cosine[n] * u[d] - sine[n] * v[d]
            py = y[n] - sine[n] * u[d] - cosine[n] * v[d]
            i, j = min(max(int(px) - 1, 0), n_x - 4), min(max(int(py) - 1, 0), n_lane - 4)
            cubic_weights(px - i, along)
            cubic_weights(py - j, across)
            value = strip.dtype.type(0.0)
            for m in range(4):
                row = strip[j + m, i : i + 4]
                on_row = along[0] * row[0] + along[1] * row[1] + along[2] * row[2] + along[3] * row[3]
                value += across[m] * on_row
            data[d, start + n] += strip.dtype.type(amplitude[n]) * value
