"""Kernels from pointing to pixels, and from time-streams to maps."""

import numpy as np

from mapmaker.kernels.compiled import njit

# Samples of a detector whose places are computed together: these stay in the cache, and loops without look-ups are
# vector instructions.
_AT_ONCE = 256


@njit(cache=True, nogil=True, error_model="numpy")
def plane_pixels(place, x_rad, y_rad, n_x, n_y):
    """Flat pixel index of every sample; -1 off the map.

    Parameters
    ----------
    place : (8, n_samp)
        Homographies from offsets in the array to columns and rows (`mapmaker.detector_places`).
    x_rad, y_rad : (n_det,)
        Detectors in the array frame.
    n_x, n_y

    Returns
    -------
    (n_det, n_samp) array
        int32.
    """
    n_det, n_samp = x_rad.size, place.shape[1]
    index = np.empty((n_det, n_samp), np.int32)
    for first in range(0, n_samp, _AT_ONCE):
        part = slice(first, min(first + _AT_ONCE, n_samp))
        c0, cx, cy, r0 = place[0, part], place[1, part], place[2, part], place[3, part]
        rx, ry, wx, wy = place[4, part], place[5, part], place[6, part], place[7, part]
        for d in range(n_det):
            x, y, found = x_rad[d], y_rad[d], index[d, part]
            for n in range(found.size):
                w = 1.0 / (1.0 + x * wx[n] + y * wy[n])
                c = (c0[n] + x * cx[n] + y * cy[n]) * w
                r = (r0[n] + x * rx[n] + y * ry[n]) * w
                inside = (w > 0.0) & (c >= 0.0) & (r >= 0.0) & (c < n_x) & (r < n_y)
                found[n] = np.int32(r) * n_x + np.int32(c) if inside else -1
    return index


@njit(cache=True, nogil=True)
def bin_samples(data, index, bounds, kept, weighted_sum, hits):
    """Add the samples of kept scans to the flat maps `weighted_sum` (float64) and `hits` (int64), in place.

    Consecutive samples in one pixel are added up first. Without `hits` (None) they are not counted.
    """
    for d in range(data.shape[0]):
        for s in range(bounds.shape[0]):
            if not kept[s]:
                continue
            samples, pixels = data[d, bounds[s, 0] : bounds[s, 1]], index[d, bounds[s, 0] : bounds[s, 1]]
            pixel, total, count = pixels[0], 0.0, 0
            for n in range(samples.size):
                if pixels[n] != pixel:
                    if pixel >= 0:
                        weighted_sum[pixel] += total
                        if hits is not None:
                            hits[pixel] += count
                    pixel, total, count = pixels[n], 0.0, 0
                total += samples[n]
                count += 1
            if pixel >= 0:
                weighted_sum[pixel] += total
                if hits is not None:
                    hits[pixel] += count


@njit(cache=True, nogil=True)
def look_up(skies, index, out):
    """Write the pixel of every sample in each of some flat skies (n_sky, n_pixel) to streams (n_sky, n_det, n_samp).

    Samples off the map (-1) are 0.
    """
    for r in range(skies.shape[0]):
        sky, streams = skies[r], out[r]
        for d in range(index.shape[0]):
            for n in range(index.shape[1]):
                pixel = index[d, n]
                streams[d, n] = sky[pixel] if pixel >= 0 else 0.0


@njit(cache=True, nogil=True)
def count_samples(index, hits):
    """Add the samples in each pixel to the flat map `hits` (int64), in place; without those off the map (-1)."""
    for d in range(index.shape[0]):
        for n in range(index.shape[1]):
            pixel = index[d, n]
            if pixel >= 0:
                hits[pixel] += 1


@njit(cache=True, nogil=True)
def add_skies(data, skies, place, x_rad, y_rad, gain):
    """Add the bilinear look-up of some skies along every detector's track to their streams, in place.

    Parameters
    ----------
    data : (n_sky, n_det, n_samp)
        Changed in place; nothing is added off the skies.
    skies : (n_sky, n_y, n_x)
    place : (8, n_samp)
        Homographies from offsets in the array to sky pixels, counted from pixel centres.
    x_rad, y_rad
        As in `plane_pixels`.
    gain : (n_det,)
    """
    n_sky, n_y, n_x = skies.shape
    next_row, one = np.uint64(n_x), np.uint64(1)
    below, across = np.empty(_AT_ONCE, np.int32), np.empty((3, _AT_ONCE), skies.dtype)
    for first in range(0, data.shape[2], _AT_ONCE):
        part = slice(first, min(first + _AT_ONCE, data.shape[2]))
        c0, cx, cy, r0 = place[0, part], place[1, part], place[2, part], place[3, part]
        rx, ry, wx, wy = place[4, part], place[5, part], place[6, part], place[7, part]
        for d in range(data.shape[1]):
            _corners(c0, cx, cy, r0, rx, ry, wx, wy, x_rad[d], y_rad[d], gain[d], n_x, n_y, below, across)
            for k in range(n_sky):
                samples, values = data[k, d, part], skies[k].reshape(n_y * n_x)
                for n in range(samples.size):
                    # Unsigned, which avoids numba's check for negative indices.
                    p, u, v, g = np.uint64(below[n]), across[0, n], across[1, n], across[2, n]
                    near, far = values[p], values[p + next_row]
                    low = near + u * (values[p + one] - near)
                    high = far + u * (values[p + next_row + one] - far)
                    samples[n] += g * (low + v * (high - low))


@njit(forceinline=True, error_model="numpy")
def _corners(c0, cx, cy, r0, rx, ry, wx, wy, x, y, gain, n_x, n_y, below, across):
    """Write the flat pixel below each sample, its distance from that along both axes, and its gain: 0 off the sky."""
    for n in range(c0.size):
        w = 1.0 / (1.0 + x * wx[n] + y * wy[n])
        c = (c0[n] + x * cx[n] + y * cy[n]) * w
        r = (r0[n] + x * rx[n] + y * ry[n]) * w
        inside = (w > 0.0) & (c >= 0.0) & (r >= 0.0) & (c < n_x - 1) & (r < n_y - 1)
        c, r = c if inside else 0.0, r if inside else 0.0
        j, i = np.int32(c), np.int32(r)
        below[n] = i * np.int32(n_x) + j
        across[0, n], across[1, n] = c - j, r - i
        across[2, n] = gain if inside else 0.0
