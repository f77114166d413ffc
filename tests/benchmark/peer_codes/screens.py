"""Turbulent screens by FFT: with pixell and numpy, and by hand in numba."""

from collections.abc import Callable

import numpy as np
from peer_codes.observation import (
    APERTURE_M,
    ARCMIN,
    B2,
    ELEVATION_RAD,
    HEIGHT_M,
    INDEX,
    MAP_PIXEL_RAD,
    Observation,
    Streams,
)

CELLS, CELL_RAD = 512, 4 * ARCMIN


def screen_power(alpha: np.ndarray) -> np.ndarray:
    """Power spectrum of the layer through the beam [mK^2 rad^2] at alpha [1/rad]; 0 at 0."""
    from scipy.special import j1

    alpha = np.maximum(alpha, 1e-9)
    argument = np.pi * alpha * APERTURE_M / HEIGHT_M * np.sin(ELEVATION_RAD)
    power = B2 * np.sin(ELEVATION_RAD) ** (1 - INDEX) * alpha**-INDEX * (2 * j1(argument) / argument) ** 2
    return np.where(alpha > 1e-6, power, 0.0)


def pixell_numpy(seen: Observation) -> Callable[[], Streams]:
    """Draw a screen for each scan and interpolate it with pixell; numpy does all else."""
    from pixell import enmap

    half = CELLS * CELL_RAD / 2
    shape, wcs = enmap.geometry(pos=[[-half, half], [half, -half]], res=CELL_RAD, proj="car")
    half = 1.1 * np.abs(seen.boresight_rad).max() + np.abs(seen.offsets_rad).max()
    map_shape, map_wcs = enmap.geometry(pos=[[-half, half], [half, -half]], res=MAP_PIXEL_RAD, proj="tan")
    spectrum = screen_power(np.arange(int(enmap.modlmap(shape, wcs).max()) + 2) / (2 * np.pi))
    rng = np.random.Generator(np.random.SFC64(1))

    def run() -> Streams:
        before = rng.standard_normal(seen.shape, dtype=np.float32)
        before *= seen.white_mk
        for first, end in seen.bounds:
            screen = enmap.rand_map(shape, wcs, spectrum[None, None], scalar=True)
            path = seen.layer_rad[first:end] - seen.layer_rad[first:end].mean(axis=0)
            position = (seen.offsets_rad[:, None] + path[None]).T[::-1]  # (dec, ra), samples, detectors
            before[:, first:end] += screen.at(position, order=3).T
        after = before - before.mean(axis=0)
        for first, end in seen.bounds:
            after[:, first:end] -= after[:, first:end].mean(axis=1, keepdims=True)
        position = (seen.offsets_rad[:, None] + seen.boresight_rad[None]).reshape(-1, 2).T[::-1]
        y, x = np.rint(enmap.sky2pix(map_shape, map_wcs, position)).astype(int)
        index, n_pixel = y * map_shape[1] + x, map_shape[0] * map_shape[1]
        hits = np.bincount(index, minlength=n_pixel)
        sums = np.bincount(index, weights=after.ravel(), minlength=n_pixel)
        enmap.enmap((sums / np.maximum(hits, 1)).reshape(map_shape), map_wcs)
        return before, after

    return run


def fft_numba(seen: Observation) -> Callable[[], Streams]:
    """Draw a screen for each scan by FFT; one kernel interpolates, subtracts and bins."""
    from numba import njit
    from scipy.fft import fftfreq, irfft2, rfftfreq

    alpha = np.hypot(fftfreq(CELLS, CELL_RAD)[:, None], rfftfreq(CELLS, CELL_RAD))
    # The inverse transform ignores the imaginary parts of the first and the last column.
    amplitude = np.sqrt(screen_power(alpha) / 2) * CELLS / CELL_RAD
    amplitude[:, [0, -1]] *= np.sqrt(2)
    amplitude = amplitude.astype(np.float32)[..., None]
    geometry = seen.setup.analysis.geometry
    n_x, n_pixel, centre = geometry.n_x, geometry.n_y * geometry.n_x, (geometry.n_x - 1) / 2
    rng = np.random.Generator(np.random.SFC64(1))

    @njit(fastmath=True)
    def add_scan(before, after, screen, offsets, layer, boresight, sums, hits):
        n_det, n_samp = before.shape
        for n in range(n_samp):
            mean = np.float32(0)
            for i in range(n_det):
                x = (offsets[i, 0] + layer[n, 0]) / CELL_RAD + CELLS / 2
                y = (offsets[i, 1] + layer[n, 1]) / CELL_RAD + CELLS / 2
                column, row = int(x), int(y)
                dx, dy = np.float32(x - column), np.float32(y - row)
                low = screen[row, column] * (1 - dx) + screen[row, column + 1] * dx
                high = screen[row + 1, column] * (1 - dx) + screen[row + 1, column + 1] * dx
                before[i, n] += low * (1 - dy) + high * dy
                mean += before[i, n]
            for i in range(n_det):
                after[i, n] = before[i, n] - mean / n_det
        for i in range(n_det):
            mean = np.float32(0)
            for n in range(n_samp):
                mean += after[i, n]
            for n in range(n_samp):
                after[i, n] -= mean / n_samp
                x = int(np.rint((offsets[i, 0] + boresight[n, 0]) / MAP_PIXEL_RAD + centre))
                y = int(np.rint((offsets[i, 1] + boresight[n, 1]) / MAP_PIXEL_RAD + centre))
                sums[y * n_x + x] += after[i, n]
                hits[y * n_x + x] += 1

    def run() -> Streams:
        before, after = rng.standard_normal(seen.shape, dtype=np.float32), np.empty(seen.shape, np.float32)
        before *= seen.white_mk
        sums, hits = np.zeros(n_pixel), np.zeros(n_pixel, np.int64)
        for first, end in seen.bounds:
            modes = rng.standard_normal((*amplitude.shape[:2], 2), dtype=np.float32)
            modes *= amplitude
            screen = irfft2(modes.view(np.complex64)[..., 0], (CELLS, CELLS))
            path = seen.layer_rad[first:end] - seen.layer_rad[first:end].mean(axis=0)
            scan = slice(first, end)
            boresight = seen.boresight_rad[scan]
            add_scan(before[:, scan], after[:, scan], screen, seen.offsets_rad, path, boresight, sums, hits)
        return before, after

    return run
