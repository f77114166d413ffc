"""Engine "processes": worker processes on this machine."""

import multiprocessing
import signal
from collections import Counter
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from threadpoolctl import threadpool_limits

from surveysim.runtime.interrupt_signals import defer_signals, hide_main_module, ignore_sigint_in_children
from surveysim.runtime.worker_loss import LOSSES_ALLOWED, log, too_many_losses

TAKEN_AHEAD = 2  # items that wait at a worker, so that it does not wait for the parent
ENDS_S = 1.0  # time for a process to end after its pipe is closed

Answer = tuple[Any, Exception | None]


@dataclass
class _Worker:
    """Worker process, the parent's end of its pipe, and the numbers of its unanswered items in order."""

    process: BaseProcess
    pipe: Connection
    has: list[int] = field(default_factory=list)


def in_processes(job: Callable[[Any], Any], items: Sequence[Any], workers: int) -> Generator[Any]:
    """Yield ``job(item)`` for each item, in order, from worker processes.

    Items of a lost worker are repeated by a new one.

    Raises
    ------
    EngineError
        If workers are lost repeatedly with the same item. Errors of the job are raised as they are.
    """
    # A pipe a worker, and not an executor's shared queues: one that is killed while it holds a lock of the
    # queue, or halfway through a result, would leave the others and the parent waiting for ever.
    crew: list[_Worker] = []
    ready: dict[int, Answer] = {}
    losses: Counter[int] = Counter()
    todo = list(range(len(items)))[::-1]
    position = 0
    try:
        while position < len(items):
            while todo and todo[-1] - position <= 3 * workers:
                worker = _least_busy(crew, job, workers)
                if worker is None:
                    break
                _give(worker, todo.pop(), items)
            ready |= _collect(crew)
            todo = sorted(todo + _of_the_lost(crew, losses), reverse=True)
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
    """Choose the worker for the next item: a new one while there are fewer than `workers`; None if all are busy."""
    if len(crew) < workers:
        with defer_signals():
            crew.append(_start(job))
        return crew[-1]
    worker = min(crew, key=lambda item: len(item.has))
    return worker if len(worker.has) < TAKEN_AHEAD else None


def _give(worker: _Worker, number: int, items: Sequence[Any]) -> None:
    worker.has.append(number)
    try:
        worker.pipe.send((number, items[number]))
    except OSError:  # it is gone, which shows when its answers are collected
        return


def _collect(crew: list[_Worker]) -> dict[int, Answer]:
    """Wait for answers and return (result, error) by number; close the pipes of lost workers."""
    found = {}
    waiting = {worker.pipe: worker for worker in crew if worker.has}
    ready: list[Any] = wait(list(waiting))
    for pipe in ready:
        try:
            number, result, error = pipe.recv()
        except (EOFError, OSError):
            pipe.close()
            continue
        waiting[pipe].has.remove(number)
        found[number] = (result, error)
    return found


def _of_the_lost(crew: list[_Worker], losses: Counter[int]) -> list[int]:
    """Remove lost workers from the crew and return the numbers of their items."""
    lost = [worker for worker in crew if worker.pipe.closed]
    for worker in lost:
        worker.process.join(ENDS_S)  # by itself, so that its exit code is its own
        worker.process.kill()
        worker.process.join()
        crew.remove(worker)
        losses[worker.has[0]] += 1  # the others had not been begun
        if losses[worker.has[0]] >= LOSSES_ALLOWED:
            raise too_many_losses(worker.process.exitcode)
        log.warning("a worker process is gone; its work is done again")
    return [number for worker in lost for number in worker.has]


def _start(job: Callable[[Any], Any]) -> _Worker:
    """Start a worker process."""
    # Spawned, not forked: a fork in a process with threads can hang, and does not exist everywhere.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(job, theirs), daemon=True)
    with ignore_sigint_in_children(), hide_main_module():
        process.start()
    theirs.close()  # held by the worker alone: its end closes with it
    return _Worker(process, ours)


def _work(job: Callable[[Any], Any], pipe: Connection) -> None:
    """Answer items from the parent until its pipe closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threadpool_limits(1)
    try:
        while True:
            number, item = pipe.recv()
            try:
                answer: tuple[int, Any, Exception | None] = (number, job(item), None)
            except Exception as error:  # whatever it is, the parent decides
                answer = (number, None, error)
            pipe.send(answer)
    except (EOFError, OSError):
        return
