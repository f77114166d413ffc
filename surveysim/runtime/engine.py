"""Engines: maps of a job over items; results do not depend on the engine or the number of workers."""

import os
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from surveysim.runtime.errors import InputError
from surveysim.runtime.interrupt_signals import defer_signals
from surveysim.runtime.items import InOrder, Items, LargeResults, UntilFailure
from surveysim.runtime.processes import in_processes, start_early
from surveysim.runtime.serial import in_turn
from surveysim.runtime.worker_loss import EngineError

__all__ = [
    "KINDS",
    "SERIAL",
    "Engine",
    "EngineError",
    "default_workers",
    "defer_signals",
    "ordered_map",
    "unordered_map",
]

KINDS = ("serial", "processes", "dask")


@dataclass(frozen=True)
class Engine:
    """Choice of the processes that simulate the observations.

    Parameters
    ----------
    kind
        "serial" for this process, "processes" for worker processes on this machine, or "dask".
    workers
        Number of worker processes on this machine; None for one per core, or none at all where a run takes a second or
        two. Not allowed with `scheduler`.
    scheduler
        Address of a dask scheduler, such as ``tcp://host:8786``, or path of its scheduler file; "dask" only.

    Raises
    ------
    InputError
        For an unknown kind, fewer than one worker, or options that exclude each other.
    """

    kind: str = "processes"
    workers: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        """Raise InputError for a choice that is not allowed."""
        if self.kind not in KINDS:
            raise InputError(f"engine: found {self.kind!r}; {', '.join(KINDS)} are there")
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers: found {self.workers}; 1 or more is expected")
        if self.scheduler is not None and self.kind != "dask":
            raise InputError(f"scheduler: found one for the engine {self.kind!r}; only 'dask' has one")
        if self.scheduler is not None and self.workers is not None:
            raise InputError("workers: found a number and a scheduler, which has workers of its own; one of the two")

    def workers_for(self, items: int) -> int:
        """Number of workers that will process so many items.

        Raises
        ------
        EngineError
            If dask is not installed or the scheduler does not answer.
        """
        if self.kind == "dask":
            from surveysim.runtime.dask_cluster import workers_of  # distributed is an extra, and takes a second to load

            if self.scheduler is not None:
                return min(workers_of(self.scheduler), max(1, items))
        if self.kind == "serial":
            return 1
        return max(1, min(self.workers or default_workers(), items))

    def for_work(self, quick: bool) -> "Engine":
        """Choose this process for quick work, unless the caller chose a number of workers."""
        return replace(self, workers=1) if quick and self.kind == "processes" and self.workers is None else self

    def start_early(self) -> None:
        """Begin to start worker processes of this machine, if there will be any, while this process gets ready."""
        if self.kind == "processes" and (self.workers or default_workers()) > 1:
            start_early()


SERIAL = Engine("serial")


def ordered_map(job: Callable[[Any], Any], items: Sequence[Any], engine: Engine) -> Generator[Any]:
    """Yield ``job(item)`` for each item, in order; parameters and errors as for `unordered_map`.

    Only a few items per worker are in progress at a time, which bounds the memory of waiting results.
    """
    in_order, ready = InOrder(items), dict[int, Any]()
    results = unordered_map(job, in_order, engine)
    try:
        for number, result in results:
            ready[number] = result
            while in_order.position in ready:
                yield ready.pop(in_order.position)
                in_order.position += 1
    finally:
        results.close()


def unordered_map(
    job: Callable[[Any], Any],
    items: Items,
    engine: Engine,
    large: LargeResults | None = None,
    meanwhile: Callable[[], None] = lambda: None,
) -> Generator[tuple[int, Any]]:
    """Yield the number of each item and ``job(item)``, as they are finished.

    Each worker uses one BLAS thread, so that sums do not depend on the number of cores. Items of a lost worker are
    repeated by others. Closing the generator early kills worker processes of this machine; workers of a cluster finish
    their items.

    Parameters
    ----------
    job
        Picklable function of one item.
    items
        Source of picklable arguments.
    engine
        Workers to use.
    large
        Results that a cluster keeps: a `Held` comes in their place, for as long as the generator is open.
    meanwhile
        Called once the first items are given to worker processes of this machine, which have yet to start.

    Raises
    ------
    EngineError
        If workers are lost repeatedly or the scheduler is gone. Once a job fails, no more items are begun; the error
        of the first item that failed is raised as it is when those in progress are finished.
    """
    source, failures = UntilFailure(items), dict[int, Exception]()
    if engine.kind == "dask":
        from surveysim.runtime.dask_cluster import on_cluster

        answers = on_cluster(job, source, engine, large)
    elif (workers := engine.workers_for(items.left())) == 1:
        answers = in_turn(job, source)
    else:
        answers = in_processes(job, source, workers, meanwhile)
    try:
        for number, result, error in answers:
            if error is None:
                yield number, result
            else:
                failures[number], source.failed = error, True
    finally:
        answers.close()
    if failures:
        raise failures[min(failures)]


def default_workers() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
