"""dask.distributed: a cluster that is there, or one of this machine for the time of the run."""

import ctypes
import json
import logging
import os
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from threadpoolctl import threadpool_limits

from surveysim import __version__
from surveysim.engines.losses import EngineError, log, too_many_losses
from surveysim.engines.signals import deaf_children, without_script

if TYPE_CHECKING:
    from surveysim.engines import Engine

try:
    from distributed import Client, Future, KilledWorker, LocalCluster
except ImportError:
    raise EngineError("engine 'dask': distributed is not installed; pip install 'surveysim[cluster]'") from None

UNIT_S = 0.5  # of work in a unit, which costs the scheduler and the way to a worker a few milliseconds
SCHEDULER_S = 5e-3  # of work in a unit for each worker: at most 200 units a second come to the scheduler
MOST_ITEMS = 32  # in a unit, whose results travel together
TAKEN_AHEAD = 2  # units a worker, so that it does not wait for the parent
CONNECT_S = 20.0
_ONE_AT_A_TIME = Lock()
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h

_ADDRESS = re.compile(r"[a-z]+://.+|[^/\\]+:\d+")


@dataclass(frozen=True)
class Answers:
    """What a unit's items gave, up to the first error, and the time that it took."""

    results: list[Any]
    error: Exception | None
    seconds: float


def run_unit(job: Callable[[Any], Any], items: Sequence[Any], version: str) -> Answers:
    """Do the items of a unit on a worker; refuses to with another version than that of the survey."""
    if version != __version__:
        error = EngineError(f"a worker has surveysim {__version__}; {version} is expected")
        return Answers([], error, 0.0)
    _keep_freed_memory()
    start, results = perf_counter(), []
    try:
        # A limit on threads is the process's: units of a worker of several threads would undo each other's.
        with _ONE_AT_A_TIME, threadpool_limits(1):
            for item in items:
                results.append(job(item))
    except Exception as error:  # whatever it is, the parent decides
        return Answers(results, error, perf_counter() - start)
    return Answers(results, None, perf_counter() - start)


def on_cluster(job: Callable[[Any], Any], items: Sequence[Any], engine: "Engine") -> Iterator[Any]:
    """`job(item)` for each item, in order, by the workers of the engine's scheduler, or processes of this machine.

    Raises what a job raises, and EngineError where the scheduler is gone or workers are lost again and again.
    """
    with _client(engine, len(items)) as client:
        for answers in _answers(client, job, items):
            yield from answers.results
            if answers.error is not None:
                raise answers.error


def _answers(client: Client, job: Callable[[Any], Any], items: Sequence[Any]) -> Iterator[Answers]:
    """Answers of all units in order, a few units a worker being under way; raises EngineError."""
    name, position, each_s = uuid4().hex, 0, None
    units: deque[Future] = deque()
    with _lost_scheduler():
        try:
            while position < len(items) or units:
                there = _workers(client)
                while position < len(items) and len(units) < TAKEN_AHEAD * there:
                    size = unit_size(each_s, there, len(items) - position)
                    unit = (job, items[position : position + size], __version__)
                    units.append(client.submit(run_unit, *unit, key=f"surveysim-{name}-{position}", pure=False))
                    position += size
                answers = units.popleft().result()
                yield answers
                each_s = answers.seconds / max(1, len(answers.results))
        finally:
            for unit in units:
                unit.release()


@cache
def _keep_freed_memory() -> None:
    """Let this process keep what it frees, within limits, as one without dask does.

    dask has its workers give freed memory back at once, and glibc maps large arrays anew in any thread but the first:
    14000 page faults and twice the time for an observation of a megabyte or two. Other C libraries are left alone.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, 32 << 20)  # the most that glibc itself goes up to
        mallopt(_M_TRIM_THRESHOLD, 1 << 30)


def unit_size(each_s: float | None, workers: int, left: int) -> int:
    """How many of the `left` items make a unit, when an item takes `each_s`, or None knows how long.

    So long that the scheduler never sees more units than it can deal with, and so short that all workers have some
    to the end.
    """
    if each_s is None:
        return 1
    wanted = max(UNIT_S, SCHEDULER_S * workers) / max(each_s, 1e-6)
    return int(max(1, min(wanted, MOST_ITEMS, left // (TAKEN_AHEAD * workers))))


def workers_of(scheduler: str) -> int:
    """How many workers a scheduler has, at least 1; raises EngineError if it does not answer."""
    with _connected(scheduler) as client:
        return max(1, len(client.nthreads()))


def _workers(client: Client) -> int:
    """How many there are now; at least one, which is then waited for."""
    there = len(client.nthreads())
    if not there:
        log.warning("the cluster has no worker yet; waiting for one")
    return max(1, there)


@contextmanager
def _client(engine: "Engine", items: int) -> Iterator[Client]:
    """A client of the scheduler, or of workers of this machine."""
    if engine.scheduler is not None:
        with _connected(engine.scheduler) as client:
            yield client
        return
    _say_losses_once()
    with deaf_children(), without_script():
        # No memory limit: a worker that is over its share of the machine while others are not need not end.
        cluster = LocalCluster(
            n_workers=engine.workers_for(items),
            threads_per_worker=1,
            memory_limit=None,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
    with cluster, Client(cluster, set_as_default=False, direct_to_workers=True) as client:
        yield client


def _connected(scheduler: str) -> Client:
    """A client of a scheduler by its address or its file; raises EngineError if none answers."""
    _say_losses_once()
    address = scheduler if _ADDRESS.fullmatch(scheduler) else _address_in(Path(scheduler))
    try:
        with deaf_children():
            return Client(address, timeout=CONNECT_S, set_as_default=False, direct_to_workers=True)
    except (OSError, ValueError) as error:
        raise EngineError(f"scheduler: none answers at {address} ({type(error).__name__})") from None


def _address_in(path: Path) -> str:
    """The address in a scheduler's file."""
    try:
        return str(json.loads(path.read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError, KeyError, TypeError):
        raise EngineError(
            f"scheduler: found '{path}', no address and no scheduler's file; tcp://host:port or such a file is expected"
        ) from None


def _say_losses_once() -> None:
    """What is lost is told by this engine, in a line: silence the tracebacks that dask logs of the same."""
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def _lost_scheduler() -> Iterator[None]:
    """Say in one line that the scheduler is gone, or that workers are again and again."""
    try:
        yield
    except KilledWorker:
        raise too_many_losses() from None
    except (ImportError, AttributeError) as error:
        raise EngineError(f"a worker can't load surveysim {__version__}: {error}") from None
    except (CancelledError, OSError):  # closed connections, time-outs
        raise EngineError("the scheduler of the cluster is gone") from None
    except RuntimeError as error:  # of a client that is no more, or a scheduler that can't read what it gets
        raise EngineError(f"the scheduler of the cluster can't go on: {str(error).partition('. ')[0]}") from None
