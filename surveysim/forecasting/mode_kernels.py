"""Kernel of the noise forecast: spectral leakage of waves into map modes by the apodization of a scan."""

import numpy as np

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def apodized_sums(strength, power, frequency, at, transfer, per_step, mean, share, own, lost):
    """Sum the leakage E[(w(f_k - f_a) - m_a w(f_k) - l_aj o_kj)^2] strength_ka power_pa over a.

    The expectation takes the fitted mode j with the probability share_j, or none.

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
    share : (n,)
    own : (n_k, n)
        Components o of the map modes along the fitted modes.
    lost : (n_a, n)
        Components l of the waves along the fitted modes.

    Returns
    -------
    (n_p, n_k) array
    """
    n_a, last = frequency.size, transfer.size - 1
    total = np.zeros((power.shape[0], at.size))
    for k in range(at.size):
        middle = 0.0
        x = abs(at[k]) * per_step
        if x < last:
            i = int(x)
            middle = transfer[i] + (x - i) * (transfer[i + 1] - transfer[i])
        row = k if strength.shape[0] > 1 else 0
        for a in range(n_a):
            value = -mean[a] * middle
            x = abs(at[k] - frequency[a]) * per_step
            if x < last:
                i = int(x)
                value += transfer[i] + (x - i) * (transfer[i + 1] - transfer[i])
            square = value * value
            for j in range(share.size):
                product = lost[a, j] * own[k, j]
                square += share[j] * product * (product - 2 * value)
            let_through = square * strength[row, a]
            for p in range(power.shape[0]):
                total[p, k] += let_through * power[p, a]
    return total
