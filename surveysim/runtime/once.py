"""Properties and functions that are computed once, when they are first asked for."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import cached_property, wraps
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits


def once(make: Callable[[Any], Any]) -> cached_property:
    """Compute a property when it is first asked for, in one thread: no bit depends on the cores of the machine."""
    return cached_property(threadpool_limits.wrap(limits=1)(make))


class Keyed(Protocol):
    """A record that a key stands for: records with one key are equal."""

    @property
    def key(self) -> Hashable:
        """Key of the record."""


_Record = TypeVar("_Record", bound=Keyed)
_Result = TypeVar("_Result")


def keep_last(size: int) -> Callable[[Callable[[_Record], _Result]], Callable[[_Record], _Result]]:
    """Keep the results of a function for the last `size` keys of its argument, but not the arguments themselves."""

    def decorate(make: Callable[[_Record], _Result]) -> Callable[[_Record], _Result]:
        found: OrderedDict[Hashable, _Result] = OrderedDict()

        @wraps(make)
        def get(record: _Record) -> _Result:
            key = record.key
            if key not in found:
                found[key] = make(record)
            found.move_to_end(key)
            if len(found) > size:
                found.popitem(last=False)
            return found[key]

        get.cache_clear = found.clear  # type: ignore[attr-defined]
        return get

    return decorate
