"""Kernels of cleaning: scans less their means, responsivities from the Gram matrix of one scan, templates."""

import numpy as np

from mapmaker.kernels import DEAD_POWER
from mapmaker.kernels.compiled import njit

# Outcomes of a scan.
DISCARDED, KEPT, GIVEN_UP = 0, 1, 2


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def remove_means(data, start, stop, block):
    """Write the samples start:stop of each row of data, less their mean, into block (n_det, stop - start); tell whether
    all are finite.
    """
    finite = True
    for d in range(data.shape[0]):
        row, out = data[d, start:stop], block[d]
        total = 0.0
        for n in range(row.size):
            total += row[n]
        finite = finite and np.isfinite(total)
        mean = total / row.size
        for n in range(row.size):
            out[n] = row[n] - mean
    return finite


@njit(cache=True, nogil=True, fastmath={"contract"})
def subtract_templates(block, shapes, templates):
    """Subtract shapes (n_par, n_det) times templates (n_par, n) from a block (n_det, n), in place."""
    for d in range(block.shape[0]):
        row = block[d]
        for k in range(templates.shape[0]):
            shape, template = shapes[k, d], templates[k]
            for n in range(row.size):
                row[n] -= shape * template[n]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _has_dead(gram):
    """Tell whether a detector has next to no power."""
    n_det = len(gram)
    least = gram[0, 0]
    total = 0.0
    for i in range(n_det):
        least = min(least, gram[i, i])
        total += gram[i, i]
    return least <= DEAD_POWER * total / n_det


@njit(cache=True, nogil=True, fastmath={"contract"})
def _apply_gram(weighted, gram, product):
    """Write weighted @ gram into product, both (n_par, n_det); gram is symmetric."""
    n_par, n_det = weighted.shape
    for k in range(n_par):
        row = product[k]
        row[:] = 0.0
        for j in range(n_det):
            weight = weighted[k, j]
            column = gram[j]
            for i in range(n_det):  # along memory, so that it vectorises without reordering sums
                row[i] += weight * column[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def correlate(basis, weighted, product, power, responsivity):
    """Write c_i = sum_n T_in d_in / sum_n T_in^2; `power` is (n_par, n_par) workspace for sum_n p_n p_n^T."""
    n_par, n_det = basis.shape
    for k in range(n_par):
        for m in range(n_par):
            total = 0.0
            for i in range(n_det):
                total += product[k, i] * weighted[m, i]
            power[k, m] = total
    for i in range(n_det):
        cross = 0.0
        square = 0.0
        for k in range(n_par):
            cross += basis[k, i] * product[k, i]
            for m in range(n_par):
                square += basis[k, i] * power[k, m] * basis[m, i]
        responsivity[i] = cross / square if square > 0.0 else np.nan


@njit(cache=True, nogil=True, fastmath={"contract"})
def project_out(held, responsivity):
    """Remove the components of c along the rows of `held`, then scale c to mean 1."""
    n_held, n_det = held.shape
    for k in range(n_held):
        component = 0.0
        for i in range(n_det):
            component += held[k, i] * responsivity[i]
        for i in range(n_det):
            responsivity[i] -= component * held[k, i]
    if n_held > 0:
        responsivity /= np.mean(responsivity)


@njit(cache=True, nogil=True, fastmath={"contract"})
def relax(step, previous, responsivity):
    """Take only the fraction `step` of an update from the previous c (under-relaxation)."""
    if step != 1.0:
        for i in range(responsivity.size):
            responsivity[i] = previous[i] + step * (responsivity[i] - previous[i])


@njit(cache=True, nogil=True, fastmath={"contract"})
def _update(basis, weighted, product, power, held, step, previous, responsivity):
    """Take one step of the iteration from sums over samples; return the mean fractional change of c.

    It is NaN for c_i that vanish or are not finite.
    """
    for i in range(responsivity.size):  # a copy of slices takes seconds to compile: it can raise
        previous[i] = responsivity[i]
    correlate(basis, weighted, product, power, responsivity)
    if not np.all(np.isfinite(responsivity)) or np.any(responsivity == 0.0):
        return np.nan
    project_out(held, responsivity)
    relax(step, previous, responsivity)
    change = 0.0
    for i in range(responsivity.size):
        change += abs(responsivity[i] / previous[i] - 1.0)
    return change / responsivity.size


@njit(cache=True, nogil=True, fastmath={"contract"})
def _weigh(basis, responsivity, weighted):
    """Write basis / c into weighted, all (n_par, n_det)."""
    for k in range(basis.shape[0]):
        for i in range(basis.shape[1]):
            weighted[k, i] = basis[k, i] / responsivity[i]


@njit(cache=True, nogil=True, fastmath={"contract"})
def iterate_responsivity(gram, basis, held, tolerance, max_iterations, step, responsivity):
    """Iterate templates and responsivities of one scan on its Gram matrix, without the streams.

    With B = basis / c, sum_n T_in d_in = sum_k basis_ki (B G)_ki and sum_n T_in^2 = basis_i^T (B G B^T) basis_i.
    Source: Sayers et al. (2010), "Average Template Subtraction" and "Higher-Order Template Subtraction".

    Parameters
    ----------
    gram : (n_det, n_det)
        G = sum_n d_in d_jn of the mean-removed scan, float64 [mK^2].
    basis : (n_par, n_det)
        Orthonormal rows that span the template shapes, float64.
    held : (n_held, n_det)
        Orthonormal rows of zero sum along which c is kept zero, float64; no rows for the paper's iteration.
    tolerance
        Mean fractional change of c at convergence.
    max_iterations
    step
        Fraction of each update that is taken; 1 in the paper.
    responsivity : (n_det,)
        First guess of c; replaced by the result, float64.

    Returns
    -------
    converged : bool
        False after `max_iterations`, for a dead detector (0 iterations), and for c_i that vanish or are not finite.
    iterations : int
    """
    n_par, n_det = basis.shape
    if _has_dead(gram):
        return False, 0
    weighted, product = np.empty((n_par, n_det)), np.empty((n_par, n_det))
    power, previous = np.empty((n_par, n_par)), np.empty(n_det)
    for iteration in range(1, max_iterations + 1):
        _weigh(basis, responsivity, weighted)
        _apply_gram(weighted, gram, product)
        change = _update(basis, weighted, product, power, held, step, previous, responsivity)
        if not change >= tolerance:
            return not np.isnan(change), iteration
    return False, max_iterations


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _sum_rows(weighted, block, templates):
    """Write weighted @ block into templates (n_par, n)."""
    n_det, n = block.shape
    for k in range(weighted.shape[0]):
        template, weight = templates[k], weighted[k]
        template[:] = 0.0
        for d in range(0, n_det - 3, 4):  # rows at a time, which read and write the template once
            a, b, c, e = block[d], block[d + 1], block[d + 2], block[d + 3]
            of_a, of_b, of_c, of_e = weight[d], weight[d + 1], weight[d + 2], weight[d + 3]
            for i in range(n):
                template[i] += of_a * a[i] + of_b * b[i] + of_c * c[i] + of_e * e[i]
        for d in range(n_det - n_det % 4, n_det):
            for i in range(n):
                template[i] += weight[d] * block[d, i]


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _multiply_rows(templates, block, product):
    """Write templates @ block^T into product (n_par, n_det)."""
    for k in range(templates.shape[0]):
        template = templates[k]
        for d in range(block.shape[0]):
            row, total = block[d], 0.0
            for i in range(row.size):
                total += template[i] * row[i]
            product[k, d] = total


@njit(cache=True, nogil=True, fastmath={"contract", "reassoc"})
def _has_dead_row(block):
    """Tell whether a row of a block has next to no power."""
    least, all_rows = np.inf, 0.0
    for d in range(block.shape[0]):
        row, own = block[d], 0.0
        for i in range(row.size):
            own += row[i] * row[i]
        least, all_rows = min(least, own), all_rows + own
    return least <= DEAD_POWER * all_rows / block.shape[0]


@njit(cache=True, nogil=True, fastmath={"contract"})
def _iterate_on_streams(block, basis, held, tolerance, max_iterations, step, most, responsivity):
    """Iterate as `iterate_responsivity`, on a mean-removed scan (n_det, n_samp); return its iterations and outcome.

    An iteration that is not expected to converge within `most` iterations, from the last two changes, is given up.
    """
    n_par, n_det = basis.shape
    if _has_dead_row(block):
        return 0, DISCARDED
    weighted, product = np.empty((n_par, n_det)), np.empty((n_par, n_det))
    power, previous = np.empty((n_par, n_par)), np.empty(n_det)
    templates, before = np.empty((n_par, block.shape[1])), np.inf
    for iteration in range(1, max_iterations + 1):
        _weigh(basis, responsivity, weighted)
        _sum_rows(weighted, block, templates)
        _multiply_rows(templates, block, product)
        change = _update(basis, weighted, product, power, held, step, previous, responsivity)
        if not change >= tolerance:
            return iteration, DISCARDED if np.isnan(change) else KEPT
        # Changes decrease by a constant factor.
        if iteration > 2 and iteration + np.log(tolerance / change) / min(np.log(change / before), -1e-3) > most:
            return iteration, GIVEN_UP
        before = change
    return max_iterations, DISCARDED


@njit(cache=True, nogil=True, fastmath={"contract"})
def _write_rest(block, shapes, templates, out):
    """Write a block (n_det, n) less shapes (n_par, n_det) times templates (n_par, n)."""
    for d in range(block.shape[0]):
        row, rest = block[d], out[d]
        for k in range(templates.shape[0] - 1):
            shape, template = shapes[k, d], templates[k]
            for n in range(row.size):
                row[n] -= shape * template[n]
        shape, template = shapes[-1, d], templates[-1]
        for n in range(row.size):
            rest[n] = row[n] - shape * template[n]


@njit(cache=True, nogil=True, fastmath={"contract"})
def clean_on_streams(
    data, bounds, basis, held, tolerance, max_iterations, step, most, responsivity, cleaned, iterations, outcome
):
    """Fit responsivities to each scan as `iterate_responsivity`, without its Gram matrix, and subtract the templates.

    Parameters
    ----------
    data : (n_det, n_samp)
    bounds : (n_scan, 2)
    basis, held, tolerance, max_iterations, step
        As in `iterate_responsivity`.
    most
        A scan that is not expected to converge within so many iterations is given up.
    responsivity : (n_scan, n_det)
        First guess of c of each scan; replaced by the result.
    cleaned : (n_det, n_samp)
        Output, in kept scans.
    iterations, outcome : (n_scan,)
        Output: iterations, and KEPT, DISCARDED or GIVEN_UP.
    """
    n_par, n_det = basis.shape
    longest = 0
    for s in range(len(bounds)):
        longest = max(longest, bounds[s, 1] - bounds[s, 0])
    room, weighted = np.empty(n_det * longest), np.empty((n_par, n_det))
    for s in range(len(bounds)):
        start, n = bounds[s, 0], bounds[s, 1] - bounds[s, 0]
        block, c = room[: n_det * n].reshape(n_det, n), responsivity[s]
        iterations[s], outcome[s] = 0, DISCARDED
        if remove_means(data, start, start + n, block):
            found = _iterate_on_streams(block, basis, held, tolerance, max_iterations, step, most, c)
            iterations[s], outcome[s] = found
        if outcome[s] == KEPT:
            templates = np.empty((n_par, n))
            _weigh(basis, c, weighted)
            _sum_rows(weighted, block, templates)
            _write_rest(block, basis * c, templates, cleaned[:, start : start + n])
