"""One item after the other, in this process."""

from collections.abc import Callable, Generator, Iterable
from typing import Any

from threadpoolctl import threadpool_limits


def in_turn(job: Callable[[Any], Any], items: Iterable[Any]) -> Generator[Any]:
    """`job(item)` for each item, in order; raises what a job raises."""
    for item in items:
        with threadpool_limits(1):
            result = job(item)
        yield result
