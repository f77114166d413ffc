"""Kernels of the trends that scans share: their covariance, joint draws, and the conditioning of strips on them."""

from math import log2

import numpy as np

from mapmaker.kernels.compiled import njit

# Conditional variance of a trend given the earlier ones, over its own variance, below which it counts as zero.
_DETERMINED = 1e-9


# Cells of `structure_table` for each factor of two, and its octaves below and above a squared beam.
TABLE_CELLS, TABLE_OCTAVES = 32, 27
# Bits of a float64 below those that number the cells of `structure_table`, and the number of its first cell.
_BELOW = np.int64(52 - log2(TABLE_CELLS))
_FIRST_CELL = np.int64((1023 - TABLE_OCTAVES) * TABLE_CELLS)
_IN_CELL, _CELL_SHARE = np.int64(2 ** int(_BELOW) - 1), 2.0 ** -int(_BELOW)
_TABLE_FROM, _TABLE_TO = 2.0**-TABLE_OCTAVES, 2.0**TABLE_OCTAVES


@njit(forceinline=True)
def structure(squared, coefficients, scale):
    """Structure function at one squared distance, from `surveysim.atmosphere.thin_screen.structure_table`.

    The exponent and the first bits of the squared distance are the number of its cell: no logarithm is taken.

    Parameters
    ----------
    squared
        Squared distance [rad^2].
    coefficients : (n, 4)
    scale : (3,)
        As in `structure_table`.
    """
    x = squared * scale[0]
    if _TABLE_FROM <= x < _TABLE_TO:
        bits = np.float64(x).view(np.int64)
        # Unsigned, which avoids numba's check for negative indices.
        c = coefficients[np.uint64((bits >> _BELOW) - _FIRST_CELL)]
        t = (bits & _IN_CELL) * _CELL_SHARE
        return ((c[0] * t + c[1]) * t + c[2]) * t + c[3]
    return _beyond_table(x, coefficients, scale)


@njit(cache=True, nogil=True)
def _beyond_table(x, coefficients, scale):
    """Structure function at a squared distance in beams below or above the table: power laws."""
    if x <= 0.0:
        return 0.0
    if x < _TABLE_FROM:
        return coefficients[0, 3] * (x / _TABLE_FROM) ** scale[1]
    c = coefficients[-1]
    return (c[0] + c[1] + c[2] + c[3]) * (x / _TABLE_TO) ** scale[2]


@njit(cache=True, nogil=True)
def _add_covariance(out, row, column, place_a, weight_a, place_b, weight_b, coefficients, scale):
    """Write the covariance of two scans' trends into out[row:, column:]: -1/2 w D w."""
    n_trend, n_point = weight_a.shape
    apart = np.empty((n_point, n_point))
    for i in range(n_point):
        for j in range(n_point):
            dx, dy = place_a[i, 0] - place_b[j, 0], place_a[i, 1] - place_b[j, 1]
            apart[i, j] = -0.5 * structure(dx * dx + dy * dy, coefficients, scale)
    for m in range(n_trend):
        half = np.zeros(n_point)
        for i in range(n_point):
            for j in range(n_point):
                half[j] += weight_a[m, i] * apart[i, j]
        for n in range(n_trend):
            total = 0.0
            for j in range(n_point):
                total += half[j] * weight_b[n, j]
            out[row + m, column + n] = total


@njit(cache=True, nogil=True)
def _factorize(matrix, size):
    """Replace the lower triangle of matrix[:size, :size] by its Cholesky factor.

    Columns of rows that are linear combinations of earlier ones are set to zero, so that a singular matrix has a
    factor.
    """
    for j in range(size):
        pivot = matrix[j, j]
        least = _DETERMINED * pivot
        for k in range(j):
            pivot -= matrix[j, k] ** 2
        root = np.sqrt(pivot) if pivot > least else 0.0
        matrix[j, j] = root
        for i in range(j + 1, size):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = total / root if root > 0.0 else 0.0


@njit(cache=True, nogil=True)
def _copy(block, out):
    """Write a block to the first rows and columns of `out`."""
    n_row, n_column = block.shape
    for i in range(n_row):
        for k in range(n_column):
            out[i, k] = block[i, k]


@njit(cache=True, nogil=True)
def draw_trends(place, weight, normals, group, coefficients, scale):
    """Draw the trends of consecutive scans in groups, each given the group before.

    Covariances within a group and between neighbouring groups are exact.

    Parameters
    ----------
    place : (n_scan, n_point, 2)
    weight : (n_scan, n_trend, n_point)
    normals : (n_scan, n_trend)
    group
        Scans in a group.
    coefficients, scale
        As in `structure`.

    Returns
    -------
    (n_scan, n_trend) array
    """
    n_scan, n_trend = normals.shape
    trends = np.empty((n_scan, n_trend))
    covariance = np.empty((2 * group * n_trend, 2 * group * n_trend))
    whitened = np.empty(2 * group * n_trend)
    own = np.empty((group * n_trend, group * n_trend))
    for start in range(0, n_scan, group):
        first, end = max(0, start - group), min(n_scan, start + group)
        size, known = (end - first) * n_trend, (start - first) * n_trend
        _copy(own[:known, :known], covariance)  # a copy of slices takes seconds to compile: it can raise
        for a in range(start, end):
            for b in range(first, a + 1):
                row, column = (a - first) * n_trend, (b - first) * n_trend
                _add_covariance(covariance, row, column, place[a], weight[a], place[b], weight[b], coefficients, scale)
        _copy(covariance[known:size, known:size], own)
        _factorize(covariance, size)
        for i in range(size):
            scan, trend = first + i // n_trend, i % n_trend
            total = 0.0
            for k in range(i):
                total += covariance[i, k] * whitened[k]
            if i < known:
                pivot = covariance[i, i]
                whitened[i] = (trends[scan, trend] - total) / pivot if pivot > 0.0 else 0.0
            else:
                whitened[i] = normals[scan, trend]
                trends[scan, trend] = total + covariance[i, i] * whitened[i]
    return trends


@njit(cache=True, nogil=True)
def impose_trends(strips, trend, lane, column, place, weight, used, step, stride, cells, coefficients, scale):
    """Change the trends of each strip to given ones: T -> T + K C^-1 (t - w T).

    Parameters
    ----------
    strips : (n_scan, n_lane, n_x)
        Changed in place; points are `step` apart.
    trend : (n_scan, n_trend)
    lane, column : (n_scan, n_point)
    place : (n_scan, n_point, 2)
    weight : (n_scan, n_trend, n_point)
    used : (n_scan,)
        Columns to change, the first ones of each strip.
    step, stride, cells
        As in `_add_field_covariances`.
    coefficients, scale
        As in `structure`.
    """
    for s in range(len(strips)):
        of_points = _point_weights(strips[s], lane[s], column[s], place[s], weight[s], trend[s], coefficients, scale)
        _add_field_covariances(
            strips[s], used[s], lane[s], column[s], of_points, step, stride, cells, coefficients, scale
        )


@njit(cache=True, nogil=True)
def _point_weights(strip, lane, column, place, weight, trend, coefficients, scale):
    """Weights w^T C^-1 (t - w T) of the field's covariance with the points, which change a strip's trends to t.

    Parameters
    ----------
    strip : (n_lane, n_x)
    lane, column : (n_point,)
        Points on the strip.
    place : (n_point, 2)
    weight : (n_trend, n_point)
        w.
    trend : (n_trend,)
        t.
    coefficients, scale
        As in `structure`.

    Returns
    -------
    (n_point,) array
    """
    n_trend, n_point = weight.shape
    factor = np.empty((n_trend, n_trend))
    _add_covariance(factor, 0, 0, place, weight, place, weight, coefficients, scale)
    _factorize(factor, n_trend)
    change = np.empty(n_trend)
    for m in range(n_trend):
        total = trend[m]
        for i in range(n_point):
            total -= weight[m, i] * strip[lane[i], column[i]]
        for k in range(m):
            total -= factor[m, k] * change[k]
        change[m] = total / factor[m, m] if factor[m, m] > 0.0 else 0.0
    for m in range(n_trend - 1, -1, -1):
        total = change[m]
        for k in range(m + 1, n_trend):
            total -= factor[k, m] * change[k]
        change[m] = total / factor[m, m] if factor[m, m] > 0.0 else 0.0
    # Not `change @ weight`: numba imports scipy.linalg for it in compiled code, where an interrupt aborts the process.
    of_points = np.zeros(n_point)
    for m in range(n_trend):
        for i in range(n_point):
            of_points[i] += change[m] * weight[m, i]
    return of_points


@njit(cache=True, nogil=True)
def _add_field_covariances(strip, used, lane, column, weight, step, stride, cells, coefficients, scale):
    """Add the field's covariance with weighted points, -1/2 sum_i weight_i D, to the first `used` columns of a strip.

    The sum is evaluated every `stride` columns and at `cells` + 1 lines across, with one more beyond each end, and is
    cubic in between. A constant keeps the level of the strip near 0, where single precision is finest.

    Parameters
    ----------
    strip : (n_lane, n_x)
        Changed in place; points are `step` apart.
    used
    lane, column, weight : (n_point,)
        Points on the strip and their weights.
    step, stride, cells
    coefficients, scale
        As in `structure`.
    """
    n_lane = strip.shape[0]
    across = (n_lane - 1) / cells
    n_y, n_x = cells + 3, (used - 1) // stride + 4
    coarse = np.zeros((n_y, n_x))
    place, squared = _squared_offsets(lane, n_y, across)
    apart = np.empty(squared.size)
    for q in range(n_x):
        for i in range(lane.size):
            if i == 0 or column[i] != column[i - 1]:
                dx = (q - 1) * stride - column[i]
                for k in range(squared.size):
                    apart[k] = structure(step * step * (dx * dx + squared[k]), coefficients, scale)
            for p in range(n_y):
                coarse[p, q] -= 0.5 * weight[i] * apart[place[i, p]]
    level = coarse.mean()
    for i in range(weight.size):
        level += strip[lane[i], column[i]] / weight.size
    coarse -= level
    along, between, row = np.empty((4, stride)), np.empty(4), np.empty(n_x)
    for r in range(stride):
        _centred_weights(r / stride, between)
        for k in range(4):
            along[k, r] = between[k]
    for n in range(n_lane):
        y = n / across
        cell = min(int(y), cells - 1)
        _centred_weights(y - cell, between)
        for q in range(n_x):
            row[q] = (
                between[0] * coarse[cell, q]
                + between[1] * coarse[cell + 1, q]
                + between[2] * coarse[cell + 2, q]
                + between[3] * coarse[cell + 3, q]
            )
        for q in range(n_x - 3):
            points = strip[n, q * stride : min((q + 1) * stride, used)]
            a, b, c, d = row[q], row[q + 1], row[q + 2], row[q + 3]
            for r in range(points.size):  # a loop without divisions, compiled to vector instructions
                points[r] += along[0, r] * a + along[1, r] * b + along[2, r] * c + along[3, r] * d


@njit(cache=True, nogil=True)
def _squared_offsets(lane, n_y, across):
    """Squares of the distances of lines across a strip from points: the place (n_point, n_y) of each, and all (n,)."""
    place, squared, n = np.empty((lane.size, n_y), np.int64), np.empty(lane.size * n_y), 0
    for i in range(lane.size):
        for p in range(n_y):
            offset = ((p - 1) * across - lane[i]) ** 2
            found = 0
            while found < n and squared[found] != offset:
                found += 1
            squared[found], place[i, p], n = offset, found, max(n, found + 1)
    return place, squared[:n]


@njit(cache=True, nogil=True)
def _centred_weights(x, weight):
    """Write the Lagrange weights (4,) of the values at -1, 0, 1 and 2 for the position x; exact for cubics."""
    a, b, c, d = x + 1.0, x, x - 1.0, x - 2.0
    weight[0] = -b * c * d / 6.0
    weight[1] = a * c * d / 2.0
    weight[2] = -a * b * d / 2.0
    weight[3] = a * b * c / 6.0
