"""Loop of the forecast: what a scan's time window makes of the layer's spectrum."""

import numpy as np

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def windowed_sums(strength, power, frequency, at, transfer, per_step, mean, share, own, lost):
    """Sum E[(w(f_k - f_a) - m_a w(f_k) - l_aj o_kj)^2] strength_ka power_pa over a, (n_p, n_k).

    The expectation takes j with the probability share_j, or none. strength (n_k, n_a), or (1, n_a) for all k alike;
    power (n_p, n_a); frequency (n_a,) and at (n_k,) [Hz]; transfer (n,) is w at steps of 1 / per_step [Hz] from 0, even
    and taken as 0 beyond its end; mean (n_a,); share (n,), own (n_k, n), lost (n_a, n).
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
