"""Spans of observations that workers simulate: whole nodes of the tree of sums where observations are quick."""

from dataclasses import dataclass

LEAF = 16  # observations that are added one after the other
SPAN_S = 4.0  # of work in a span: its sums come back once, a killed run loses them
_SHARES = 4  # spans a worker that are left when a span begins, so that all workers end together


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
    """

    def __init__(self, missing: list[int], *, single: bool) -> None:
        self._missing, self._single = missing[::-1], single
        self._each_s: float | None = None

    def left(self) -> int:
        """Number of observations that are not handed out."""
        return len(self._missing)

    def take(self, workers: int) -> tuple[int, Span] | None:
        """Hand out the next span, keyed by its first observation; None if none is left."""
        if not self._missing:
            return None
        first = self._missing[-1]
        size = self._size(first, workers)
        del self._missing[-size:]
        return first, Span(first, first + size)

    def measured(self, each_s: float) -> None:
        """Note the time that an observation took [s]."""
        self._each_s = each_s

    def _size(self, first: int, workers: int) -> int:
        """Find the largest node that starts with an observation, is missing as a whole and takes neither too long
        nor too large a share of the work; 1 where there is none."""
        if self._single or self._each_s is None:
            return 1
        most, size = min(SPAN_S / max(self._each_s, 1e-6), len(self._missing) / (_SHARES * workers)), LEAF
        if size > most or not self._is_whole(first, size):
            return 1
        while 2 * size <= most and self._is_whole(first, 2 * size):
            size *= 2
        return size

    def _is_whole(self, first: int, size: int) -> bool:
        return first % size == 0 and len(self._missing) >= size and self._missing[-size] == first + size - 1
