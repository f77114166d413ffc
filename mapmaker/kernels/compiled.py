"""Compilation of kernels, without a cache where no directory for it is writable."""

import logging
from collections.abc import Callable
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import numba
from numba.core.event import TimingListener, register


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


def is_cached(kernel: Any) -> bool:
    """Return whether a compiled kernel is on disk, so that a process loads it and does not compile it."""
    folder = kernel.stats.cache_path
    return folder is not None and any(Path(folder).glob(f"*.{kernel.__name__}-*.nbc"))


def compile_s() -> float:
    """Time [s] that kernels have taken to compile, or to load from the cache, in this process since the first call."""
    timer = _compile_timer()
    return timer.duration if timer.done else 0.0


@cache
def _compile_timer() -> TimingListener:
    timer = TimingListener()
    register("numba:compiler_lock", timer)
    return timer


@cache
def _say_once() -> None:
    if parent_process() is None:  # which warns for its workers
        logging.getLogger("mapmaker").warning(
            "no cache of compiled functions: every process compiles them anew; set NUMBA_CACHE_DIR to a directory that "
            "can be written"
        )
