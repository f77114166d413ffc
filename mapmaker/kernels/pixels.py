"""Kernels from pointing to pixels, and from time-streams to maps."""

import numpy as np

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def plane_pixels(column, row, cos, sin, x_rad, y_rad, n_x, n_y):
    """Flat pixel index of every sample; -1 off the map.

    Parameters
    ----------
    column, row : (n_samp,)
        Boresight in pixels.
    cos, sin : (n_samp,)
        Cosine and sine of the array angle, over the pixel size.
    x_rad, y_rad : (n_det,)
        Detectors in the array frame.
    n_x, n_y

    Returns
    -------
    (n_det, n_samp) array
        int32.
    """
    n_det, n_samp = x_rad.size, column.size
    index = np.empty((n_det, n_samp), np.int32)
    for d in range(n_det):
        x, y = x_rad[d], y_rad[d]
        for n in range(n_samp):
            c = column[n] + x * cos[n] - y * sin[n]
            r = row[n] + x * sin[n] + y * cos[n]
            inside = (c >= 0.0) & (r >= 0.0) & (c < n_x) & (r < n_y)
            index[d, n] = np.int32(r) * n_x + np.int32(c) if inside else -1
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
def add_sky(data, sky, column, row, cos, sin, x_rad, y_rad, gain):
    """Add the bilinear look-up of a sky along every detector's track, in place.

    Parameters
    ----------
    data : (n_det, n_samp)
        Changed in place; nothing is added off the sky.
    sky : (n_y, n_x)
    column, row : (n_samp,)
        Boresight in sky pixels, counted from pixel centres.
    cos, sin, x_rad, y_rad
        As in `plane_pixels`.
    gain : (n_det,)
    """
    n_y, n_x = sky.shape
    for d in range(data.shape[0]):
        x, y, g = x_rad[d], y_rad[d], gain[d]
        for n in range(data.shape[1]):
            c = column[n] + x * cos[n] - y * sin[n]
            r = row[n] + x * sin[n] + y * cos[n]
            if (c >= 0.0) & (r >= 0.0) & (c < n_x - 1) & (r < n_y - 1):
                i, j = int(r), int(c)
                v, u = r - i, c - j
                low = sky[i, j] + u * (sky[i, j + 1] - sky[i, j])
                high = sky[i + 1, j] + u * (sky[i + 1, j + 1] - sky[i + 1, j])
                data[d, n] += g * (low + v * (high - low))
