"""Engine "serial": one item after the other, in this process."""

import sys
from collections.abc import Callable, Generator
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController

from surveysim.runtime.items import Answer, Items
from surveysim.runtime.memory import keep_freed_memory


def in_turn(job: Callable[[Any], Any], items: Items) -> Generator[Answer]:
    """Yield the answer for each item, in order."""
    keep_freed_memory()
    while (taken := items.take(1)) is not None:
        number, item = taken
        try:
            with _libraries(len(sys.modules)).limit(limits=1):
                answer: Answer = (number, job(item), None)
        except Exception as error:  # whatever it is, the caller decides
            answer = (number, None, error)
        yield answer


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """Libraries with threads, searched for (1 ms) again once other modules are loaded."""
    return ThreadpoolController()
