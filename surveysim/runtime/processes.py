"""Engine "processes": worker processes on this machine."""

import multiprocessing
import os
import pickle
import signal
import socket
from collections import Counter
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from multiprocessing import forkserver
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from threading import Thread
from typing import Any

from threadpoolctl import threadpool_limits

from surveysim.runtime.environment import postpone_unused
from surveysim.runtime.interrupt_signals import defer_signals, hide_main_module, ignore_sigint_in_children
from surveysim.runtime.items import Answer, Items
from surveysim.runtime.memory import keep_freed_memory
from surveysim.runtime.messages import pickled, receive, send, send_parts, sendable
from surveysim.runtime.worker_loss import LOSSES_ALLOWED, EngineError, log, too_many_losses

TAKEN_AHEAD = 2  # items that wait at a worker, so that it does not wait for the parent
# Not forked from this process: a fork of a process with threads can hang. Where there is a fork server, its workers
# share the modules that it has imported.
METHOD = "forkserver" if "forkserver" in multiprocessing.get_all_start_methods() else "spawn"
SHARED = "surveysim.survey.worker_imports"  # module of the imports that workers share
ENDS_S = 1.0  # time for a process to end after its channel is closed


@dataclass
class _Worker:
    """Worker process, the parent's end of its channel, and its unanswered items by number, in order."""

    process: BaseProcess
    channel: socket.socket
    has: dict[int, Any] = field(default_factory=dict)


def start_early() -> None:
    """Start the process that workers are forked from, if there is one: it imports while this process gets ready."""
    if METHOD == "forkserver":
        forkserver.set_forkserver_preload([SHARED])
        with ignore_sigint_in_children(), hide_main_module():
            forkserver.ensure_running()


def in_processes(
    job: Callable[[Any], Any], items: Items, workers: int, meanwhile: Callable[[], None] = lambda: None
) -> Generator[Answer]:
    """Yield the answer for each item from worker processes, as they come.

    Items of a lost worker are repeated by a new one. `meanwhile` is called once the first items are given.

    Raises
    ------
    EngineError
        If workers are lost repeatedly with the same item.
    """
    # A channel a worker, and not an executor's shared queues: one that is killed while it holds a lock of the
    # queue, or halfway through a result, would leave the others and the parent waiting for ever.
    crew: list[_Worker] = []
    again: dict[int, Any] = {}
    losses: Counter[int] = Counter()

    def give() -> None:
        while _has_room(crew, workers) and (taken := _next(again, items, workers)) is not None:
            _give(_least_busy(crew, job, workers), *taken)

    try:
        give()
        meanwhile()
        while True:
            give()
            if not any(worker.has for worker in crew):
                return
            yield from _collect(crew)
            again |= _of_the_lost(crew, losses)
    finally:
        for worker in crew:
            worker.process.kill()
            worker.process.join()
            worker.channel.close()


def _next(again: dict[int, Any], items: Items, workers: int) -> tuple[int, Any] | None:
    """Take the first of the items of lost workers, or else a new one."""
    if again:
        number = min(again)
        return number, again.pop(number)
    return items.take(workers)


def _has_room(crew: list[_Worker], workers: int) -> bool:
    """Return whether a worker can be started, or waits for few items."""
    return len(crew) < workers or min(len(worker.has) for worker in crew) < TAKEN_AHEAD


def _least_busy(crew: list[_Worker], job: Callable[[Any], Any], workers: int) -> _Worker:
    """Choose the worker for the next item: a new one while there are fewer than `workers`."""
    if len(crew) < workers:
        with defer_signals():
            crew.append(_start(job))
        return crew[-1]
    return min(crew, key=lambda item: len(item.has))


def _give(worker: _Worker, number: int, item: Any) -> None:
    worker.has[number] = item
    try:
        send(worker.channel, (number, item))
    except OSError:  # it is gone, which shows when its answers are collected
        return


def _collect(crew: list[_Worker]) -> list[Answer]:
    """Wait for answers; close the channels of lost workers."""
    found = []
    waiting = {worker.channel: worker for worker in crew if worker.has}
    ready: list[Any] = wait(list(waiting))
    for channel in ready:
        try:
            answer: Answer = receive(channel)
        except (EOFError, OSError):
            channel.close()
            continue
        del waiting[channel].has[answer[0]]
        found.append(answer)
    return found


def _of_the_lost(crew: list[_Worker], losses: Counter[int]) -> dict[int, Any]:
    """Remove lost workers from the crew and return their items by number."""
    found: dict[int, Any] = {}
    for worker in [worker for worker in crew if worker.channel.fileno() < 0]:
        worker.process.join(ENDS_S)  # by itself, so that its exit code is its own
        worker.process.kill()
        worker.process.join()
        crew.remove(worker)
        first = next(iter(worker.has))
        losses[first] += 1  # the others had not been begun
        if losses[first] >= LOSSES_ALLOWED:
            raise too_many_losses(worker.process.exitcode)
        log.warning("a worker process is gone; its work is done again")
        found |= worker.has
    return found


def _start(job: Callable[[Any], Any]) -> _Worker:
    """Start a worker process."""
    start_early()
    context: Any = multiprocessing.get_context(METHOD)
    ours, theirs = socket.socketpair()
    process = context.Process(target=_work, args=(pickle.dumps(job), theirs), daemon=True)
    try:
        with ignore_sigint_in_children(), hide_main_module():
            process.start()
    except (EOFError, ConnectionError):
        raise EngineError("the process that starts workers is gone, or was killed for want of memory") from None
    theirs.close()  # held by the worker alone: its end closes with it
    return _Worker(process, ours)


def _work(pickled_job: bytes, channel: socket.socket) -> None:
    """Answer items from the parent until its channel closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    postpone_unused()
    job: Callable[[Any], Any] = pickle.loads(pickled_job)
    threadpool_limits(1)
    keep_freed_memory()
    answers = SimpleQueue[Answer]()
    # The next item does not wait until the parent takes a large answer.
    Thread(target=_send_all, args=(channel, answers), daemon=True).start()
    try:
        while True:
            number, item = receive(channel)
            try:
                answers.put((number, job(item), None))
            except Exception as error:  # whatever it is, the parent decides
                answers.put((number, None, sendable(error)))
    except (EOFError, OSError):
        return


def _send_all(channel: socket.socket, answers: "SimpleQueue[Answer]") -> None:
    """Send answers as they come; the process ends when the parent is gone."""
    try:
        while True:
            send_parts(channel, _pickled(answers.get()))
    finally:
        os._exit(1)


def _pickled(answer: Answer) -> list[memoryview]:
    """Pickle an answer, or for a result that can't be pickled the error that says so."""
    number, result, _ = answer
    try:
        return pickled(answer)
    except Exception as error:
        error.add_note(f"a result of type {type(result).__qualname__} can't be sent by a worker")
        return pickled((number, None, sendable(error)))
