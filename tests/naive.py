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
