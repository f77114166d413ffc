"""Engines: ordered maps of observations over workers. The order of results never depends on them."""

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import Any

from threadpoolctl import threadpool_limits

_job: Callable[[Any], Any] | None = None


def ordered_map(job: Callable[[Any], Any], items: Iterable[Any], workers: int) -> Iterator[Any]:
    """`job(item)` for each item, in order: in this process for one worker, else in worker processes.

    One BLAS thread a worker, so that sums do not depend on the machine's cores. At most a few items a
    worker are under way at a time: results wait in bounded memory.
    """
    if workers == 1:
        yield from _serial(job, items)
    else:
        yield from _processes(job, items, workers)


def _serial(job: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    for item in items:
        with threadpool_limits(1):
            result = job(item)
        yield result


def _processes(job: Callable[[Any], Any], items: Iterable[Any], workers: int) -> Iterator[Any]:
    # Spawned, not forked: a fork in a process with threads can hang, and does not exist everywhere.
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_start_worker, initargs=(job,))
    waiting: deque = deque()
    try:
        for item in items:
            waiting.append(pool.submit(_run_job, item))
            if len(waiting) > 3 * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _start_worker(job: Callable[[Any], Any]) -> None:
    global _job
    # Ctrl-C goes to the whole process group; the parent decides what happens.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)
    _job = job


def _run_job(item: Any) -> Any:
    return _job(item)
