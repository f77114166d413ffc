"""Spans of observations that workers simulate: whole nodes of the tree of sums where observations are quick."""

from dataclasses import dataclass

from surveysim.reduction.resource_limits import LEAF

SPAN_S = 4.0  # of work in a span: its sums come back once, a killed run loses them
SPAN_S_A_WORKER = 0.02  # of work in a span for each worker: at most fifty come back a second
_SHARES = 2  # spans a worker that are left when a large span begins, so that all workers end together
_FEW_WORKERS = 32  # that share their last observations one by one
_UNTIMED = 8  # observations that are handed out before the first has told its time


@dataclass(frozen=True)
class Span:
    """Observations [first, end)."""

    first: int
    end: int


class Spans:
    """The missing observations of a run, handed out in order.

    Parameters
    ----------
    missing
        Numbers of the observations, in order.
    single
        Whether to hand out one observation at a time.
    each_s
        Estimate of the time of an observation [s]; None for none. Spans have at most one leaf until the first is timed.
    """

    def __init__(self, missing: list[int], *, single: bool, each_s: float | None = None) -> None:
        self._missing, self._single = missing[::-1], single
        self._each_s, self._is_timed = each_s, False
        self._untimed = 0

    def left(self) -> int:
        """Number of observations that are not handed out."""
        return len(self._missing)

    def take(self, workers: int) -> tuple[int, Span] | None:
        """Hand out the next span, keyed by its first observation; None if none is left, or no time is known yet."""
        if not self._missing or (self._untimed >= _UNTIMED and not self._single):
            return None
        if not self._is_timed:
            self._untimed += 1
        first = self._missing[-1]
        size = self._size(first, workers)
        del self._missing[-size:]
        return first, Span(first, first + size)

    def measured(self, each_s: float) -> None:
        """Note the time that an observation took [s]."""
        self._each_s, self._is_timed, self._untimed = each_s, True, 0

    def _size(self, first: int, workers: int) -> int:
        """Find the largest node that starts with an observation, is missing as a whole and takes neither too long nor
        too large a share of the work; 1 where there is none."""
        if self._single or self._each_s is None:
            return 1
        most, left = max(SPAN_S, SPAN_S_A_WORKER * workers) / max(self._each_s, 1e-6), len(self._missing)
        if most < LEAF or not self._is_whole(first, LEAF) or (workers <= _FEW_WORKERS and left < LEAF * workers):
            return 1
        size = LEAF
        while self._is_timed and 2 * size <= min(most, left / (_SHARES * workers)) and self._is_whole(first, 2 * size):
            size *= 2
        return size

    def _is_whole(self, first: int, size: int) -> bool:
        return first % size == 0 and len(self._missing) >= size and self._missing[-size] == first + size - 1
