"""Loops of the running sums."""

from mapmaker.kernels.compiled import njit


@njit(cache=True, nogil=True)
def add_signed(total, values, signs):
    """Add `signs[k] * values` to `total[k]`, in place: total (K, n, n) of any strides, values (n, n), signs (K,)."""
    for k in range(signs.size):
        sign = signs[k]
        for i in range(values.shape[0]):
            for j in range(values.shape[1]):
                total[k, i, j] += sign * values[i, j]
