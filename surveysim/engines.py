"""Engines: ordered maps of observations over workers. The order of results never depends on them."""

import multiprocessing
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from threadpoolctl import threadpool_limits

TAKEN_AHEAD = 2  # items that wait at a worker, so that it does not wait for the parent


class WorkerLostError(RuntimeError):
    """A worker process is gone: killed, or out of memory."""


def ordered_map(job: Callable[[Any], Any], items: Iterable[Any], workers: int) -> Iterator[Any]:
    """`job(item)` for each item, in order: in this process for one worker, else in worker processes.

    One BLAS thread a worker, so that sums do not depend on the machine's cores. At most a few items a
    worker are under way at a time: results wait in bounded memory. Closing the iterator early ends the
    workers at once. Raises what a job raises, and WorkerLostError when a worker is gone.
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


@dataclass
class _Worker:
    """A worker process, this end of its pipe, and how many items it has not answered."""

    process: BaseProcess
    pipe: Connection
    open_items: int = 0


def _processes(job: Callable[[Any], Any], items: Iterable[Any], workers: int) -> Iterator[Any]:
    # A pipe a worker, and not an executor's shared queues: one that is killed while it holds a lock of the
    # queue, or halfway through a result, would leave the others and the parent waiting for ever.
    crew: list[_Worker] = []
    numbered = enumerate(items)
    ready: dict[int, tuple[Any, Exception | None]] = {}
    position = 0
    entry = next(numbered, None)
    try:
        while entry is not None or any(worker.open_items for worker in crew):
            while entry is not None and entry[0] - position <= 3 * workers:
                worker = _least_busy(crew, job, workers)
                if worker is None:
                    break
                _give(worker, entry)
                entry = next(numbered, None)
            ready |= _collect(crew)
            while position in ready:
                result, error = ready.pop(position)
                if error is not None:
                    raise error
                yield result
                position += 1
    finally:
        for worker in crew:
            worker.process.kill()
            worker.process.join()
            worker.pipe.close()


def _least_busy(crew: list[_Worker], job: Callable[[Any], Any], workers: int) -> _Worker | None:
    """The worker to give an item to, a new one while there are fewer than `workers`; None if all are busy."""
    if len(crew) < workers:
        with held_back_signals():
            crew.append(_start(job))
        return crew[-1]
    worker = min(crew, key=lambda item: item.open_items)
    return worker if worker.open_items < TAKEN_AHEAD else None


def _give(worker: _Worker, entry: tuple[int, Any]) -> None:
    try:
        worker.pipe.send(entry)
    except OSError:
        raise WorkerLostError("a worker process is gone") from None
    worker.open_items += 1


def _collect(crew: list[_Worker]) -> dict[int, tuple[Any, Exception | None]]:
    """(result, error) by number, of all workers that have one; waits for the first."""
    found = {}
    waiting = {worker.pipe: worker for worker in crew if worker.open_items}
    for pipe in wait(list(waiting)):
        try:
            number, result, error = pipe.recv()
        except (EOFError, OSError):
            raise WorkerLostError("a worker process is gone") from None
        waiting[pipe].open_items -= 1
        found[number] = (result, error)
    return found


def _start(job: Callable[[Any], Any]) -> _Worker:
    """A new worker, deaf to Ctrl-C from its first instruction.

    A terminal sends Ctrl-C to the whole process group, and the parent decides what happens: a signal that is
    blocked here is so in the worker.
    """
    # Spawned, not forked: a fork in a process with threads can hang, and does not exist everywhere.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(job, theirs), daemon=True)
    if hasattr(signal, "pthread_sigmask"):
        resource_tracker.ensure_running()  # unblocks signals when it is started
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    else:
        process.start()
    theirs.close()  # held by the worker alone: its end closes with it
    return _Worker(process, ours)


def _work(job: Callable[[Any], Any], pipe: Connection) -> None:
    """Answer items from the parent until it is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)
    try:
        while True:
            number, item = pipe.recv()
            try:
                answer = (number, job(item), None)
            except Exception as error:  # whatever it is, the parent decides
                answer = (number, None, error)
            pipe.send(answer)
    except (EOFError, OSError):
        return
