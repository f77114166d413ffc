"""Kernels of standard normal deviates: Philox 4x32-10 (Salmon et al. 2011, SC '11) and the transform of Box and Muller.

A deviate is a function of its stream and its position. A tile of 64 deviates takes 16 counters: each gives four words,
and each pair of words two deviates. Loops over the lanes of a tile are compiled to vector instructions. All operations
are integer, or IEEE additions, multiplications, divisions and square roots, none of them contracted: every machine
gives the same bits.
"""

from math import factorial, log, pi, sqrt

import numpy as np

from mapmaker.kernels.compiled import njit

LANES = 16
TILE = 4 * LANES
ROUNDS = 10
# Multipliers and key increments of Philox 4x32.
_MULTIPLIER_0, _MULTIPLIER_1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_INCREMENT_0, _INCREMENT_1 = np.uint32(0x9E3779B9), np.uint32(0xBB67AE85)
_HALF_WORD = np.uint64(32)
# Counters of the words that refine float64 deviates have this bit set in their second word.
_REFINING = np.uint32(0x80000000)
_NEGATIVE, _SWAPPED, _LOW = np.uint32(0x80000000), np.uint32(0x40000000), np.uint32(0xFF)
_ONE_BITS, _SQRT_HALF_BITS = (np.int32(np.float32(x).view(np.int32)) for x in (1.0, sqrt(0.5)))
# Taylor series in z = s^2 of -4 artanh(s) / s, and in z = t^2 of sin(pi t / 4) / t and cos(pi t / 4), to the rounding
# error of each precision for |s| <= (sqrt(2) - 1)^2 and |t| <= 1.
_LOG = np.array([-4 / (2 * k + 1) for k in range(10)])
_SIN = np.array([(-1) ** k * (pi / 4) ** (2 * k + 1) / factorial(2 * k + 1) for k in range(10)])
_COS = np.array([(-1) ** k * (pi / 4) ** (2 * k) / factorial(2 * k) for k in range(10)])
_LOG_32, _SIN_32, _COS_32 = (series[:5].astype(np.float32) for series in (_LOG, _SIN, _COS))


@njit(forceinline=True)
def philox(c0, c1, c2, c3, k0, k1):
    """Four random words of a counter (four words) and a key (two words), all uint32."""
    for _ in range(ROUNDS):
        product_0, product_1 = _MULTIPLIER_0 * np.uint64(c0), _MULTIPLIER_1 * np.uint64(c2)
        c0, c1 = np.uint32(product_1 >> _HALF_WORD) ^ c1 ^ k0, np.uint32(product_1)
        c2, c3 = np.uint32(product_0 >> _HALF_WORD) ^ c3 ^ k1, np.uint32(product_0)
        k0, k1 = np.uint32(k0 + _INCREMENT_0), np.uint32(k1 + _INCREMENT_1)
    return c0, c1, c2, c3


@njit(forceinline=True)
def _five_terms(z, c):
    return c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * c[4])))


@njit(forceinline=True)
def _series(z, coefficients):
    value = _five_terms(z, coefficients)
    if coefficients.size > 5:
        value += (z * z) * (z * z) * z * _five_terms(z, coefficients[5:])
    return value


@njit(forceinline=True, error_model="numpy")
def _minus_two_log(tail, upper, series):
    """-2 ln(u), of u = 1 - tail (`upper`) or tail, to the relative precision of the tail in (0, 1/2]."""
    real = series.dtype.type
    u = real(1) - tail if upper else tail
    # u = 2^exponent (1 + f), with 1 + f between sqrt(1/2) and sqrt(2).
    exponent = np.int32(np.float32(u).view(np.int32) - _SQRT_HALF_BITS) >> np.int32(23)
    scale = np.int32(_ONE_BITS - np.int32(exponent << np.int32(23))).view(np.float32)
    f = -tail if upper and exponent == 0 else u * real(scale) - real(1)
    s = f / (f + real(2))
    return s * _series(s * s, series) + real(exponent) * real(-2 * log(2))


@njit(forceinline=True, error_model="numpy")
def _box_muller(word_0, word_1, low_0, low_1, log_series, sin_series, cos_series):
    """Two deviates of 40 bits of radius, 24 of angle, and fractions `low_0` and `low_1` of the last bits."""
    real = log_series.dtype.type
    high = np.int32(word_0)
    half = high >> np.int32(31)
    tail = real(np.int32(high ^ half)) * real(2.0**-32) + (real(np.int32(word_1 & _LOW)) + low_0) * real(2.0**-40)
    radius = real(sqrt(_minus_two_log(tail, half != 0, log_series)))
    radius = -radius if word_1 & _NEGATIVE else radius
    t = (real(np.int32(word_1 << np.uint32(2)) >> np.int32(10)) + low_1) * real(2.0**-21)
    sine, cosine = t * _series(t * t, sin_series), _series(t * t, cos_series)
    if word_1 & _SWAPPED:
        return radius * sine, radius * cosine
    return radius * cosine, radius * sine


@njit()
def _tile_float32(out, number, stream):
    first = np.uint64(number) * np.uint64(LANES)
    low, high, half = np.uint32(first), np.uint32(first >> _HALF_WORD), np.float32(0.5)
    for lane in range(LANES):
        counter = np.uint32(low + np.uint32(lane))
        a, b, c, d = philox(counter, high, stream[2], stream[3], stream[0], stream[1])
        out[lane], out[lane + LANES] = _box_muller(a, b, half, half, _LOG_32, _SIN_32, _COS_32)
        out[lane + 2 * LANES], out[lane + 3 * LANES] = _box_muller(c, d, half, half, _LOG_32, _SIN_32, _COS_32)


@njit(forceinline=True)
def _fraction(word):
    return (np.float64(word) + 0.5) * 2.0**-32


@njit()
def _tile_float64(out, number, stream):
    first = np.uint64(number) * np.uint64(LANES)
    low, high = np.uint32(first), np.uint32(first >> _HALF_WORD)
    for lane in range(LANES):
        counter = np.uint32(low + np.uint32(lane))
        a, b, c, d = philox(counter, high, stream[2], stream[3], stream[0], stream[1])
        e, f, g, h = philox(counter, high | _REFINING, stream[2], stream[3], stream[0], stream[1])
        out[lane], out[lane + LANES] = _box_muller(a, b, _fraction(e), _fraction(f), _LOG, _SIN, _COS)
        out[lane + 2 * LANES], out[lane + 3 * LANES] = _box_muller(c, d, _fraction(g), _fraction(h), _LOG, _SIN, _COS)


@njit(forceinline=True)
def _fill(out, first, stream, fill_tile):
    scratch = np.empty(TILE, out.dtype)
    done, number, skip = 0, first // TILE, first % TILE
    while done < out.size:
        n = min(TILE - skip, out.size - done)
        whole = n == TILE
        fill_tile(out[done : done + TILE] if whole else scratch, number, stream)
        if not whole:
            for i in range(n):  # a copy of slices takes seconds to compile: it can raise
                out[done + i] = scratch[skip + i]
        done, number, skip = done + n, number + 1, 0


@njit(cache=True, nogil=True)
def fill_float32(out, first, stream):
    """Fill `out` (n,) float32 with the deviates `first` to `first + n - 1` of a stream (4,) uint32."""
    _fill(out, first, stream, _tile_float32)


@njit(cache=True, nogil=True)
def fill_float64(out, first, stream):
    """As `fill_float32`, in float64: the same deviates, with more digits."""
    _fill(out, first, stream, _tile_float64)


@njit(forceinline=True)
def _add(out, scale, first, stream, fill_tile):
    scratch = np.empty(TILE, out.dtype)
    done, number, skip = 0, first // TILE, first % TILE
    while done < out.size:
        n = min(TILE - skip, out.size - done)
        fill_tile(scratch, number, stream)
        part = out[done : done + n]
        for i in range(n):
            part[i] += scale * scratch[skip + i]
        done, number, skip = done + n, number + 1, 0


@njit(cache=True, nogil=True)
def add_float32(out, scale, first, stream):
    """Add the deviates of `fill_float32`, times a float32 scale, to `out` (n,), in place."""
    _add(out, scale, first, stream, _tile_float32)


@njit(cache=True, nogil=True)
def add_float64(out, scale, first, stream):
    """As `add_float32`, in float64."""
    _add(out, scale, first, stream, _tile_float64)
