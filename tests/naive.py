"""Slow, obvious twins of the kernels: loops that can be read against the equations."""

import numpy as np


def average_cleaning(scan_mk, tolerance, max_iterations):
    """Average subtraction of one scan in the paper's own two equations; returns (cleaned, c)."""
    data = scan_mk - scan_mk.mean(axis=1, keepdims=True)
    n_det, n_samp = data.shape
    c = np.ones(n_det)
    for _ in range(max_iterations):
        template = [sum(data[i, n] / c[i] for i in range(n_det)) / sum(1 / c) for n in range(n_samp)]
        square = sum(t * t for t in template)
        cross = [sum(template[n] * data[i, n] for n in range(n_samp)) for i in range(n_det)]
        updated = np.array(cross) / square
        change = np.mean(np.abs(updated / c - 1))
        c = updated
        if change < tolerance:
            template = [sum(data[i, n] / c[i] for i in range(n_det)) / sum(1 / c) for n in range(n_samp)]
            return data - np.outer(c, template), c
    raise ArithmeticError("not converged")


def template_cleaning(scan_mk, shapes, hold, tolerance, max_iterations):
    """Polynomial templates of one scan, sample by sample; returns (cleaned, c, steps).

    shapes: S, (n_det, n_par), first column constant. hold: take the fit of S to c, except for the constant,
    out of c after every step.
    """
    data = scan_mk - scan_mk.mean(axis=1, keepdims=True)
    n_det, n_samp = data.shape
    fit = np.linalg.inv(shapes.T @ shapes) @ shapes.T

    def templates(c):
        return np.array([shapes @ (fit @ (data[:, n] / c)) for n in range(n_samp)]).T

    c = np.ones(n_det)
    for step in range(1, max_iterations + 1):
        template = templates(c)
        updated = np.empty(n_det)
        for i in range(n_det):
            updated[i] = sum(template[i] * data[i]) / sum(template[i] ** 2)
        if hold:
            updated = updated - shapes @ (fit @ updated) + updated.mean()
            updated = updated / updated.mean()
        change = np.mean(np.abs(updated / c - 1))
        c = updated
        if change < tolerance:
            return data - c[:, None] * templates(c), c, step
    raise ArithmeticError("not converged")


def add_screen(data, start, stop, strip, x0, y0, dx, amplitude):
    """Bilinear look-up of every detector's track, from the four lattice points around each sample."""
    n_lane, n_x = strip.shape
    for d in range(data.shape[0]):
        for n in range(stop - start):
            x, y = x0[d] + n * dx, y0[d]
            i, j = min(int(x), n_x - 2), min(int(y), n_lane - 2)
            s, t = x - i, y - j
            along_near = (1 - s) * strip[j, i] + s * strip[j, i + 1]
            along_far = (1 - s) * strip[j + 1, i] + s * strip[j + 1, i + 1]
            data[d, start + n] += amplitude * ((1 - t) * along_near + t * along_far)


def combine_columns(columns, start, normals):
    """Modes (n_lane, n_freq): for each frequency its factors times complex normal amplitudes."""
    n_freq, n_lane = len(start) - 1, columns.shape[1]
    modes = np.zeros((n_lane, n_freq), complex)
    for k in range(n_freq):
        for r in range(start[k], start[k + 1]):
            modes[:, k] += columns[r] * complex(normals[2 * r], normals[2 * r + 1])
    return modes


def plane_pixels(column, row, cos, sin, x_rad, y_rad, n_x, n_y):
    """The pixel that holds each sample, by rounding down; -1 off the map."""
    index = np.full((len(x_rad), len(column)), -1)
    for d in range(len(x_rad)):
        for n in range(len(column)):
            c = np.floor(column[n] + x_rad[d] * cos[n] - y_rad[d] * sin[n])
            r = np.floor(row[n] + x_rad[d] * sin[n] + y_rad[d] * cos[n])
            if c in range(n_x) and r in range(n_y):
                index[d, n] = r * n_x + c
    return index


def bin_samples(data, index, bounds, kept, n_pixel):
    """Sums and hits of each pixel, pixel by pixel."""
    n_samp = data.shape[1]
    used = np.zeros(n_samp, bool)
    for (start, stop), keep in zip(bounds, kept, strict=True):
        for n in range(start, stop):
            used[n] = keep
    seen = [used & (index == pixel) for pixel in range(n_pixel)]
    return np.array([data[s].sum(dtype=float) for s in seen]), np.array([s.sum() for s in seen])


def add_sky(data, sky, column, row, cos, sin, x_rad, y_rad, gain):
    """Bilinear look-up of the sky by the area that each of four pixels has in common with a shifted one."""
    n_y, n_x = sky.shape
    for d in range(data.shape[0]):
        for n in range(data.shape[1]):
            c = column[n] + x_rad[d] * cos[n] - y_rad[d] * sin[n]
            r = row[n] + x_rad[d] * sin[n] + y_rad[d] * cos[n]
            if not (0 <= c < n_x - 1 and 0 <= r < n_y - 1):
                continue
            for i in range(n_y):
                for j in range(n_x):
                    data[d, n] += gain[d] * sky[i, j] * max(0, 1 - abs(r - i)) * max(0, 1 - abs(c - j))


def add_signed(total, values, signs):
    """Signed copies, one by one."""
    for k in range(len(signs)):
        total[k] = total[k] + signs[k] * values
