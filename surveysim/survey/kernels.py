"""Loops of the running sums."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def add_signed(total, values, signs):
    """Add `signs[k, b] * values[b]` to `total[k]` for each b in turn, in place.

    total (K, n, n) of any strides, values (B, n, n), signs (K, B).
    """
    for k in range(signs.shape[0]):
        for i in range(values.shape[1]):
            for b in range(signs.shape[1]):
                sign = signs[k, b]
                for j in range(values.shape[2]):
                    total[k, i, j] += sign * values[b, i, j]
