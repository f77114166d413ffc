"""Properties that are computed once, when they are first asked for."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

from threadpoolctl import threadpool_limits


def once(make: Callable[[Any], Any]) -> cached_property:
    """Compute a property when it is first asked for, in one thread: no bit depends on the cores of the machine."""
    return cached_property(threadpool_limits.wrap(limits=1)(make))
