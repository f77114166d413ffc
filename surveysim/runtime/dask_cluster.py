"""dask.distributed: a cluster that is there, or one of this machine for the time of the run."""

import ctypes
import logging
import os
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pickle import loads
from threading import Lock
from time import monotonic, perf_counter
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from threadpoolctl import threadpool_limits

from surveysim import __version__
from surveysim.runtime.addresses import address_of
from surveysim.runtime.interrupt_signals import deaf_children, without_script
from surveysim.runtime.worker_loss import EngineError, log, too_many_losses

if TYPE_CHECKING:
    from surveysim.runtime.engine import Engine

try:
    from distributed import Client, Future, KilledWorker, LocalCluster
    from distributed.protocol import pickle

    from surveysim.runtime import dask_scheduler as schedulers
except ImportError:
    raise EngineError("engine 'dask': distributed is not installed; in the clone: pip install '.[cluster]'") from None

UNIT_S = 0.5  # of work in a unit, which costs the scheduler and the way to a worker a few milliseconds
SCHEDULER_S = 5e-3  # of work in a unit for each worker: at most 200 units a second come to the scheduler
MOST_ITEMS = 32  # in a unit, whose results travel together
TAKEN_AHEAD = 2  # units a worker, so that it does not wait for the parent
LOOK_S = 2.0  # between looks at whether the cluster has any worker, while its answers are waited for
WAIT_S = 24 * 3600.0  # for a first worker: as long as a batch queue may take
SAY_EVERY_S = 300.0  # that it still waits
ANSWER_S = 60.0  # in which a scheduler that is busy has to answer
CLOSE_S = 5.0  # for a farewell to the scheduler
DIRECT = {"direct_to_workers": True}
_ONE_AT_A_TIME = Lock()
_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3  # of malloc.h


@dataclass(frozen=True)
class Answers:
    """What a unit's items gave, up to the first error, and the time that it took."""

    results: list[Any]
    error: Exception | None
    seconds: float


@dataclass(frozen=True)
class Unit:
    """Pickled work of a worker. It is pickled itself as a call of `run_unit`: whoever reads it does the work.

    A worker that was sent objects of a package that it does not have would break its connection and end; one that is
    to read bytes fails with an error that comes back.
    """

    job: bytes
    items: bytes
    version: str

    def __reduce__(self) -> tuple:
        return run_unit, (self.job, self.items, self.version)


def run_unit(job: bytes, items: bytes, version: str) -> Answers:
    """Do the items of a unit on a worker; refuses to with another version than that of the survey.

    That is before it reads job and items, which another version may not be able to.
    """
    if version != __version__:
        error = EngineError(f"a worker has surveysim {__version__}; {version} is expected")
        return Answers([], error, 0.0)
    _keep_freed_memory()
    work, units = loads(job), loads(items)
    start, results = perf_counter(), []
    try:
        # A limit on threads is the process's: units of a worker of several threads would undo each other's.
        with _ONE_AT_A_TIME, threadpool_limits(1):
            for item in units:
                results.append(work(item))
    except Exception as error:  # whatever it is, the parent decides
        return Answers(results, error, perf_counter() - start)
    return Answers(results, None, perf_counter() - start)


def on_cluster(job: Callable[[Any], Any], items: Sequence[Any], engine: "Engine") -> Generator[Any]:
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
        pickled, watch = pickle.dumps(job), _Watch(client)
        try:
            while position < len(items) or units:
                there = max(1, watch.workers())
                while position < len(items) and len(units) < TAKEN_AHEAD * there:
                    size = unit_size(each_s, there, len(items) - position)
                    unit = Unit(pickled, pickle.dumps(items[position : position + size]), __version__)
                    key = f"surveysim-{name}-{position}"
                    units.append(client.submit(loads, pickle.dumps(unit), key=key, pure=False))
                    position += size
                answers = watch.result(units.popleft())
                yield answers
                each_s = answers.seconds / max(1, len(answers.results))
        finally:
            for unit in units:
                unit.release()


class _Watch:
    """Waits for answers of a cluster, but not for ever while it has no worker, or where its scheduler is silent."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.since: float | None = None  # there has been no worker
        self.said = 0.0

    def workers(self) -> int:
        """How many there are; says now and then that there is none, and raises EngineError after `WAIT_S` of that."""
        there = len(self.client.sync(self.client.scheduler.ncores, callback_timeout=ANSWER_S))
        now = monotonic()
        if there:
            self.since = None
        elif self.since is None or now - self.said >= SAY_EVERY_S:
            self.since, self.said = self.since or now, now
            log.warning(f"the cluster has no worker; waiting for one, for {_hours(self.since + WAIT_S - now)} at most")
        elif now - self.since >= WAIT_S:
            raise EngineError(f"the cluster has had no worker for {_hours(WAIT_S)}")
        return there

    def result(self, unit: Future) -> Answers:
        """The answers of a unit, once a worker has given them."""
        while True:
            with suppress(TimeoutError):  # of this look alone: what a job raises comes in its answers
                return unit.result(timeout=LOOK_S)
            self.workers()


def _hours(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds:.0f} s"


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
    _say_losses_once()
    return max(1, schedulers.workers_at(address_of(scheduler)))


@contextmanager
def _client(engine: "Engine", items: int) -> Iterator[Client]:
    """A client of the scheduler, or of workers of this machine."""
    if engine.scheduler is not None:
        client = _connected(engine.scheduler)
        try:
            yield client
        finally:
            # A scheduler that is silent by now would keep the end of the run waiting.
            with suppress(TimeoutError, OSError, RuntimeError):
                client.close(timeout=CLOSE_S)
        return
    _say_losses_once()
    with _started(engine.workers_for(items)) as cluster, Client(cluster, set_as_default=False, **DIRECT) as client:
        yield client


def _started(workers: int) -> LocalCluster:
    """Workers of this machine; raises EngineError where they can't be started."""
    try:
        with deaf_children(), without_script():
            # No memory limit: a worker that is over its share of the machine while others are not need not end.
            return LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=None,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
    except Exception as error:  # of files, processes or threads that a limit of the machine forbids
        raise EngineError(f"engine 'dask': no workers can be started here ({schedulers.reason(error)})") from None


def _connected(scheduler: str) -> Client:
    """A client of a scheduler by its address or its file; raises EngineError if none answers."""
    _say_losses_once()
    address, limit = address_of(scheduler), schedulers.CONNECT_S
    schedulers.workers_at(address)  # its own end is sure, which that of a client is not while it connects
    return schedulers.within(limit, address, lambda: Client(address, timeout=limit, set_as_default=False, **DIRECT))


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
        raise EngineError(f"a worker can't load surveysim {__version__}: {schedulers.reason(error)}") from None
    except (CancelledError, OSError):  # closed connections, time-outs
        raise EngineError("the scheduler of the cluster is gone") from None
    except RuntimeError as error:  # of a client that is no more, or a scheduler that can't read what it gets
        raise EngineError(f"the cluster's scheduler failed: {schedulers.reason(error)}") from None
