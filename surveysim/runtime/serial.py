"""Engine "serial": one item after the other, in this process."""

from collections.abc import Callable, Generator, Iterable
from typing import Any

from threadpoolctl import threadpool_limits


def in_turn(job: Callable[[Any], Any], items: Iterable[Any]) -> Generator[Any]:
    """Yield ``job(item)`` for each item, in order."""
    for item in items:
        with threadpool_limits(1):
            result = job(item)
        yield result
