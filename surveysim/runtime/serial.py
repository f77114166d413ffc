"""Engine "serial": one item after the other, in this process."""

from collections.abc import Callable, Generator
from typing import Any

from threadpoolctl import threadpool_limits

from surveysim.runtime.items import Answer, Items
from surveysim.runtime.memory import keep_freed_memory


def in_turn(job: Callable[[Any], Any], items: Items) -> Generator[Answer]:
    """Yield the answer for each item, in order."""
    keep_freed_memory()
    while (taken := items.take(1)) is not None:
        number, item = taken
        try:
            with threadpool_limits(1):
                answer: Answer = (number, job(item), None)
        except Exception as error:  # whatever it is, the caller decides
            answer = (number, None, error)
        yield answer
