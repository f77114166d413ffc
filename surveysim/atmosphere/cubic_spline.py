"""Piecewise cubics with scipy's coefficients, without scipy.interpolate, which takes 0.2 s to import."""

from collections.abc import Sequence
from copy import copy

import numpy as np


class _Cubics:
    """Cubics between knots, from values (n,) and first derivatives (n,) at them."""

    def __init__(self, x: np.ndarray, y: np.ndarray, first: np.ndarray) -> None:
        self.x, width = x, np.diff(x)
        slope = np.diff(y) / width
        bend = (first[:-1] + first[1:] - 2 * slope) / width
        # Coefficients (4, n - 1) of the powers 3, 2, 1, 0 of the distance from the knot below.
        self.c = np.stack([bend / width, (slope - first[:-1]) / width - bend, first[:-1], y[:-1]])

    def __call__(self, x: np.ndarray, derivative: int = 0, member: np.ndarray | None = None) -> np.ndarray:
        """Evaluate the cubics, or their first `derivative`, at `x` of any shape; the last ones go on beyond.

        `member`, shaped as `x`, has the number of a spline in a stack for each.
        """
        x = np.asarray(x, dtype=float)
        # Of single numbers np.clip takes longer than all else.
        below = np.minimum(np.maximum(np.searchsorted(self.x, x, side="right") - 1, 0), len(self.x) - 2)
        c = self.c[:, below] if member is None else self.c[:, below, member]
        h, (cubic, square, linear, constant) = x - self.x[below], c
        if derivative:
            return linear + square * h * 2 + cubic * (h * h) * 3
        return constant + linear * h + square * (h * h) + cubic * (h * h * h)


class CubicSpline(_Cubics):
    """Cubic spline through points, with the third derivative continuous at the second knot from each end.

    It is `scipy.interpolate.CubicSpline` with its default "not-a-knot" ends, for four knots or more.

    Parameters
    ----------
    x, y : (n,)
        Knots, increasing, and values.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray) -> None:
        super().__init__(x, y, _smooth_slopes(x, np.diff(x), np.diff(y) / np.diff(x)))


def stacked_splines(x: np.ndarray, y: np.ndarray) -> CubicSpline:
    """Return splines through points (m, n) at common knots (n,) as one, whose values at a single number are (m,)."""
    return stack_of([CubicSpline(x, row) for row in y])


def stack_of(splines: Sequence[CubicSpline]) -> CubicSpline:
    """Return splines with common knots as one; see `stacked_splines`."""
    stack = copy(splines[0])
    stack.c = np.stack([spline.c for spline in splines], axis=-1)
    return stack


class MonotoneCubic(_Cubics):
    """Piecewise cubic that is monotone where the values are (Fritsch and Butland 1984).

    It is `scipy.interpolate.PchipInterpolator`, for two knots or more.

    Parameters
    ----------
    x, y : (n,)
        Knots, increasing, and values.
    """

    def __init__(self, x: np.ndarray, y: np.ndarray) -> None:
        super().__init__(x, y, _monotone_slopes(np.diff(x), np.diff(y) / np.diff(x)))


def _monotone_slopes(width: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """First derivatives at the knots (n,): weighted harmonic means of the slopes, 0 where the slopes change sign."""
    if len(slope) == 1:
        return np.repeat(slope, 2)
    below, above = 2 * width[1:] + width[:-1], width[1:] + 2 * width[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = 1 / ((below / slope[:-1] + above / slope[1:]) / (below + above))
    inner = np.where(np.sign(slope[:-1]) * np.sign(slope[1:]) > 0, mean, 0)
    ends = _end_slope(width[:2], slope[:2]), _end_slope(width[:-3:-1], slope[:-3:-1])
    return np.concatenate([ends[:1], inner, ends[1:]])


def _end_slope(width: np.ndarray, slope: np.ndarray) -> float:
    """First derivative of the parabola through three points at the outer one, limited to stay monotone."""
    found = ((2 * width[0] + width[1]) * slope[0] - width[0] * slope[1]) / (width[0] + width[1])
    if np.sign(found) != np.sign(slope[0]):
        return 0.0
    if np.sign(slope[0]) != np.sign(slope[1]) and abs(found) > 3 * abs(slope[0]):
        return 3 * slope[0]
    return found


def _smooth_slopes(x: np.ndarray, width: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """First derivatives at the knots (n,), from a tridiagonal system."""
    start, end = x[2] - x[0], x[-1] - x[-3]
    above = np.concatenate([[start], width[:-1]])
    middle = np.concatenate([[width[1]], 2 * (width[:-1] + width[1:]), [width[-2]]])
    below = np.concatenate([width[1:], [end]])
    first = ((width[0] + 2 * start) * width[1] * slope[0] + width[0] ** 2 * slope[1]) / start
    last = (width[-1] ** 2 * slope[-2] + (2 * end + width[-1]) * width[-2] * slope[-1]) / end
    right = np.concatenate([[first], 3 * (width[1:] * slope[:-1] + width[:-1] * slope[1:]), [last]])
    return np.array(_solve(below.tolist(), middle.tolist(), above.tolist(), right.tolist()))


def _solve(below: list[float], middle: list[float], above: list[float], right: list[float]) -> list[float]:
    """Solve a tridiagonal system in place by elimination with row exchanges, in the order of LAPACK's dgtsv."""
    n, second = len(middle), [0.0] * len(middle)  # `second`: two above the diagonal, filled by exchanges
    for i in range(n - 1):
        if abs(middle[i]) >= abs(below[i]):
            factor = below[i] / middle[i]
            middle[i + 1] -= factor * above[i]
            right[i + 1] -= factor * right[i]
            continue
        factor = middle[i] / below[i]
        middle[i], above[i], middle[i + 1] = below[i], middle[i + 1], above[i] - factor * middle[i + 1]
        if i < n - 2:
            second[i], above[i + 1] = above[i + 1], -factor * above[i + 1]
        right[i], right[i + 1] = right[i + 1], right[i] - factor * right[i + 1]
    right[-1] /= middle[-1]
    right[-2] = (right[-2] - above[-1] * right[-1]) / middle[-2]
    for i in range(n - 3, -1, -1):
        right[i] = (right[i] - above[i] * right[i + 1] - second[i] * right[i + 2]) / middle[i]
    return right
