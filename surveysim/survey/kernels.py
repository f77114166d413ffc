"""Loops of the running sums."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def add_signed(total, values, signs):
    """Add `signs[k, b] * values[b]` to `total[k]` for each b in turn, in place.

    total (K, n_set, n, n) and values (B, n_set, n, n), contiguous, signs (K, B).
    """
    for k in range(signs.shape[0]):
        for s in range(values.shape[1]):
            for i in range(values.shape[2]):
                row = total[k, s, i]
                for b in range(signs.shape[1]):
                    sign, added = signs[k, b], values[b, s, i]
                    for j in range(added.size):
                        row[j] += sign * added[j]
