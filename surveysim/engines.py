"""Engines: ordered maps of observations over workers. The order of results never depends on them."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any

from threadpoolctl import threadpool_limits

_job: Callable[[Any], Any] | None = None


def ordered_map(job: Callable[[Any], Any], items: Iterable[Any], workers: int) -> Iterator[Any]:
    """`job(item)` for each item, in order: in this process for one worker, else in worker processes.

    One BLAS thread a worker, so that sums do not depend on the machine's cores. At most a few items a
    worker are under way at a time: results wait in bounded memory. Closing the iterator early ends the
    workers at once. Raises what a job raises, and BrokenProcessPool when a worker is gone.
    """
    if workers == 1:
        yield from _serial(job, items)
    else:
        yield from _processes(job, items, workers)


@contextmanager
def held_back_signals() -> Iterator[None]:
    """Let SIGINT and SIGTERM wait until the end of the block, so that what it changes is never half done."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[int] = []
    previous = {
        number: signal.signal(number, lambda number, frame: waiting.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    if waiting:
        signal.raise_signal(waiting[0])


def _serial(job: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    for item in items:
        with threadpool_limits(1):
            result = job(item)
        yield result


def _processes(job: Callable[[Any], Any], items: Iterable[Any], workers: int) -> Iterator[Any]:
    # Spawned, not forked: a fork in a process with threads can hang, and does not exist everywhere.
    context = multiprocessing.get_context("spawn")
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker, initargs=(job,))
    waiting: deque = deque()
    finished = False
    try:
        for item in items:
            waiting.append(_submit(pool, item))
            if len(waiting) > 3 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
        finished = True
    finally:
        if not finished:
            for process in set(multiprocessing.active_children()) - others:
                process.kill()
        pool.shutdown(wait=True, cancel_futures=True)


def _submit(pool: ProcessPoolExecutor, item: Any) -> Future:
    """Submit an item; a worker that this starts is deaf to Ctrl-C from its first instruction.

    A terminal sends Ctrl-C to the whole process group, and the parent decides what happens: a signal that is
    blocked here is so in the worker. A pool that is interrupted while it starts one would never end.
    """
    with held_back_signals():
        if not hasattr(signal, "pthread_sigmask"):
            return pool.submit(_run_job, item)
        resource_tracker.ensure_running()  # unblocks signals when it is started
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return pool.submit(_run_job, item)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start_worker(job: Callable[[Any], Any]) -> None:
    global _job
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    threadpool_limits(1)
    _job = job


def _end_with_parent() -> None:
    # A parent that is killed can't tell its workers to end; they would wait for work for ever.
    multiprocessing.parent_process().join()
    os._exit(1)


def _run_job(item: Any) -> Any:
    return _job(item)
