"""Items of a map: sources that hand them out to workers, and results that stay where they are made."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

AHEAD = 3  # items a worker that may be finished before an earlier one

Answer = tuple[int, Any, Exception | None]  # number of an item, result, error


class Held(Protocol):
    """A result that stays on the cluster."""

    @property
    def outline(self) -> Any:
        """Outline of the result."""

    def fetch(self) -> Any:
        """Get the result itself."""

    def joined(self, other: Any) -> "Held":
        """Join two results on the cluster."""


@dataclass(frozen=True)
class LargeResults:
    """Large results of a map, which a cluster may keep and join.

    Parameters
    ----------
    is_large
        Whether the result of an item is large.
    outline
        Small outline of a large result; the outline of a sum is the sum of outlines.
    join
        Sum of two of them; it leaves both as they are.
    """

    is_large: Callable[[Any], bool]
    outline: Callable[[Any], Any]
    join: Callable[[Any, Any], Any]


class Items(Protocol):
    """Source of items for workers."""

    def left(self) -> int:
        """Number of items that are not handed out; an estimate where their sizes are chosen later."""
        ...

    def take(self, workers: int) -> tuple[int, Any] | None:
        """Hand out the next item with its number; None if there is none now."""
        ...


@dataclass
class InOrder:
    """Items of a sequence, a few ahead of the first that is not finished (`position`)."""

    items: Sequence[Any]
    position: int = 0
    taken: int = 0

    def left(self) -> int:
        """Number of items that are not handed out."""
        return len(self.items) - self.taken

    def take(self, workers: int) -> tuple[int, Any] | None:
        """Hand out the next item; None if none is left or too many wait for an earlier one."""
        if not self.left() or self.taken - self.position > AHEAD * workers:
            return None
        self.taken += 1
        return self.taken - 1, self.items[self.taken - 1]


@dataclass
class UntilFailure:
    """Items of a source until one has `failed`."""

    source: Items
    failed: bool = False

    def left(self) -> int:
        """Number of items that are not handed out."""
        return 0 if self.failed else self.source.left()

    def take(self, workers: int) -> tuple[int, Any] | None:
        """Hand out the next item of the source; None after a failure."""
        return None if self.failed else self.source.take(workers)
