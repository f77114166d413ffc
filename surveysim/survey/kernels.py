"""Loops of the running sums."""

from mapmaker.kernels.compiled import njit

# Pixels that are summed together: those of a leaf's observations stay in the cache, and so does their sum.
_AT_ONCE = 512


@njit(cache=True, nogil=True)
def add_signed(total, values, signs):
    """Add `signs[k, b] * values[b]` to `total[k]` for each b in turn, in place.

    total (K, n_pixel), values (B, n_pixel) and signs (K, B), contiguous and of one type.
    """
    for first in range(0, values.shape[1], _AT_ONCE):
        part = slice(first, min(first + _AT_ONCE, values.shape[1]))
        for k in range(signs.shape[0]):
            row = total[k, part]
            for b in range(signs.shape[1]):
                sign, added = signs[k, b], values[b, part]
                for j in range(added.size):
                    row[j] += sign * added[j]
