"""Kernels of the noise forecast: phases of waves at the detectors, and their leakage into map modes by a scan."""

import math

import numpy as np

from mapmaker.kernels.compiled import njit

# Taylor series, which end below 1e-15 at a quarter of a turn.
_COSINE = tuple((-1.0) ** n / math.factorial(2 * n) for n in range(12))
_SINE = tuple((-1.0) ** n / math.factorial(2 * n + 1) for n in range(11))


@njit(cache=True, nogil=True)
def unit_phases(x, y, k_x, k_y, out):
    """Fill `out` (n, m) with exp(i k.r) of points (n,) and wavevectors (m,), to 1e-16 of the largest angle.

    Angles are folded to a quarter of a turn on both sides of 0 or of half a turn, without branches for vectorisation:
    a tenth of the time of library functions.
    """
    cosine, sine = np.empty(k_x.size), np.empty(k_x.size)
    for i in range(x.size):
        for j in range(k_x.size):
            half_turns = (x[i] * k_x[j] + y[i] * k_y[j]) / math.pi
            whole = np.rint(half_turns)
            angle = (half_turns - whole) * math.pi
            sign = 1.0 - 4.0 * abs(0.5 * whole - np.rint(0.5 * whole))  # -1 for odd ones
            square = angle * angle
            even, odd = _COSINE[11], _SINE[10]
            for n in range(10, -1, -1):
                even = even * square + _COSINE[n]
            for n in range(9, -1, -1):
                odd = odd * square + _SINE[n]
            cosine[j], sine[j] = sign * even, sign * angle * odd
        for j in range(k_x.size):
            out[i, j] = complex(cosine[j], sine[j])


@njit(cache=True, nogil=True)
def look_up(table, last, x, centre, per_step, out):
    """Interpolate an even table, 0 beyond its end, at ``|x - centre| per_step``, without branches for vectorisation."""
    for i in range(x.size):
        place = abs(x[i] - centre) * per_step
        within = min(place, last - 1e-9)
        below = int(within)
        value = table[below] + (within - below) * (table[below + 1] - table[below])
        out[i] = value if place < last else 0.0


@njit(cache=True, nogil=True, fastmath={"reassoc"})
def dot(x, y):
    """Sum products in any order, so that it is vectorised; numba's ``np.dot`` would import scipy.linalg."""
    total = 0.0
    for i in range(x.size):
        total += x[i] * y[i]
    return total


@njit(cache=True, nogil=True)
def apodized_sums(strength, power, frequency, at, transfer, per_step, mean, loose, share, own, lost, filtered):
    """Sum the leakage E[(w(f_k - f_a) - m_a w(f_k) - r_ka - l_aj o_kj)^2] strength_ka power_pa over a.

    The expectation takes the fitted mode j with the probability share_j, or none, and the product of the first two
    terms less the part n_a.

    Parameters
    ----------
    strength : (n_k, n_a), or (1, n_a) for all k alike
    power : (n_p, n_a)
    frequency : (n_a,)
        Frequencies f_a of the waves [Hz].
    at : (n_k,)
        Frequencies f_k of the map modes [Hz].
    transfer : (n,)
        w at steps of 1 / per_step [Hz] from 0; w is even, and 0 beyond the table.
    per_step : float
    mean : (n_a,)
        Components m of the waves along the scan's mean.
    loose : (n_a,)
        Part n that averages out over the places of the taper in the scan.
    share : (n,)
    own : (n_k, n)
        Components o of the map modes along the fitted modes.
    lost : (n, n_a)
        Components l of the waves along the fitted modes.
    filtered : (n_k, n_a), or (0, 0) without filters
        Amplitudes r that filters in time remove.

    Returns
    -------
    (n_p, n_k) array
    """
    n_a, last = frequency.size, transfer.size - 1
    total = np.zeros((power.shape[0], at.size))
    middle, value, passed = np.zeros(1), np.zeros(n_a), np.zeros(n_a)
    for k in range(at.size):
        look_up(transfer, last, at[k : k + 1], 0.0, per_step, middle)
        look_up(transfer, last, frequency, at[k], per_step, value)
        row = k if strength.shape[0] > 1 else 0
        for a in range(n_a):
            lost_mean = mean[a] * middle[0]
            averaged = 2 * loose[a] * lost_mean * value[a]
            value[a] -= lost_mean
            if filtered.size:
                value[a] -= filtered[k, a]
            passed[a] = value[a] * value[a] + averaged
        for j in range(share.size):
            weight, lose = share[j], own[k, j]
            for a in range(n_a):
                product = lost[j, a] * lose
                passed[a] += weight * product * (product - 2 * value[a])
        for a in range(n_a):
            passed[a] *= strength[row, a]
        for p in range(power.shape[0]):
            total[p, k] = dot(power[p], passed)
    return total
