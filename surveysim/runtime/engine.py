"""Engines: ordered maps of observations over workers. Neither the results nor their order depend on them."""

import os
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Any

from surveysim.runtime.errors import InputError
from surveysim.runtime.interrupt_signals import defer_signals
from surveysim.runtime.processes import in_processes
from surveysim.runtime.serial import in_turn
from surveysim.runtime.worker_loss import EngineError

__all__ = ["KINDS", "SERIAL", "Engine", "EngineError", "default_workers", "defer_signals", "ordered_map"]

KINDS = ("serial", "processes", "dask")


@dataclass(frozen=True)
class Engine:
    """What runs observations: "serial" in this process, "processes" of this machine, or "dask" workers.

    `workers` is how many processes there are on this machine, None for one a core; a cluster that is reached through
    its `scheduler` (an address such as ``tcp://host:8786``, or the scheduler's file) has as many as it has.
    Raises InputError for what makes no sense.
    """

    kind: str = "processes"
    workers: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        """Check the choice."""
        if self.kind not in KINDS:
            raise InputError(f"engine: found {self.kind!r}; {', '.join(KINDS)} are there")
        if self.workers is not None and self.workers < 1:
            raise InputError(f"workers: found {self.workers}; 1 or more is expected")
        if self.scheduler is not None and self.kind != "dask":
            raise InputError(f"scheduler: found one for the engine {self.kind!r}; only 'dask' has one")
        if self.scheduler is not None and self.workers is not None:
            raise InputError("workers: found a number beside a scheduler, which has workers of its own; one of the two")

    def workers_for(self, items: int) -> int:
        """How many workers so many items are for; asks the scheduler if there is one.

        Raises EngineError for an engine that is not there.
        """
        if self.kind == "dask":
            from surveysim.runtime.dask_cluster import workers_of  # distributed is an extra, and takes a second to load

            if self.scheduler is not None:
                return min(workers_of(self.scheduler), max(1, items))
        if self.kind == "serial":
            return 1
        return max(1, min(self.workers or default_workers(), items))


SERIAL = Engine("serial")


def ordered_map(job: Callable[[Any], Any], items: Sequence[Any], engine: Engine) -> Generator[Any]:
    """`job(item)` for each item, in order.

    One BLAS thread a worker, so that sums do not depend on the machine's cores. At most a few items a worker are
    under way at a time: results wait in bounded memory. What a lost worker had is done again by others. Closing the
    iterator early ends workers of this machine at once, those of a cluster after what they are at. Raises what a job
    raises, and EngineError when the engine can't go on.
    """
    if engine.kind == "dask":
        from surveysim.runtime.dask_cluster import on_cluster

        yield from on_cluster(job, items, engine)
    elif (workers := engine.workers_for(len(items))) == 1:
        yield from in_turn(job, items)
    else:
        yield from in_processes(job, items, workers)


def default_workers() -> int:
    """One worker a core that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
