"""Compilation of kernels, without a cache where no directory for it is writable."""

import logging
from collections.abc import Callable
from functools import cache
from multiprocessing import parent_process
from typing import Any

import numba


def njit(**options: Any) -> Callable[[Callable], Callable]:
    """`numba.njit` with these options; without `cache` where numba finds no place for one.

    Numba looks at NUMBA_CACHE_DIR, the module's directory and the user's cache directory, and would else fail the
    import.
    """

    def compiled(function: Callable) -> Callable:
        try:
            return numba.njit(**options)(function)
        except RuntimeError:
            _say_once()
            return numba.njit(**options | {"cache": False})(function)

    return compiled


@cache
def _say_once() -> None:
    if parent_process() is None:  # which warns for its workers
        logging.getLogger("mapmaker").warning(
            "no cache of compiled functions: every process compiles them anew; set NUMBA_CACHE_DIR to a directory that "
            "can be written"
        )
