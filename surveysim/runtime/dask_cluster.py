"""Engine "dask": workers of an existing cluster, or of a temporary one on this machine."""

import logging
import math
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pickle import loads
from queue import Empty, SimpleQueue
from threading import Lock
from time import monotonic, perf_counter
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from threadpoolctl import threadpool_limits

from surveysim import __version__
from surveysim.runtime.addresses import address_of
from surveysim.runtime.interrupt_signals import hide_main_module, ignore_sigint_in_children
from surveysim.runtime.items import Answer, Items, LargeResults
from surveysim.runtime.memory import keep_freed_memory
from surveysim.runtime.messages import sendable
from surveysim.runtime.worker_loss import EngineError, log, too_many_losses

if TYPE_CHECKING:
    from surveysim.runtime.engine import Engine

try:
    from distributed import Client, Future, KilledWorker, LocalCluster
    from distributed.protocol import pickle

    from surveysim.runtime import dask_scheduler as schedulers
except ImportError:
    raise EngineError("engine 'dask': distributed is not installed; in the clone: pip install '.[cluster]'") from None

UNIT_S = 0.5  # work in a unit; sending it costs the scheduler and the network a few milliseconds
SCHEDULER_S = 5e-3  # work in a unit per worker: the scheduler handles at most 200 units a second
MOST_ITEMS = 32  # items in a unit; their results are sent together
TAKEN_AHEAD = 2  # units a worker, so that it does not wait for the parent
OUTLINES = 256  # outlines that come back together
COUNT_EVERY_S = 1.0  # between counts of the workers
LOOK_S = 2.0  # interval of checks for workers while waiting for answers
WAIT_S = 24 * 3600.0  # time to wait for a first worker, as long as a batch queue may take
SAY_EVERY_S = 300.0  # interval of warnings while waiting
ANSWER_S = 60.0  # longest time for an answer of a busy scheduler
CLOSE_S = 5.0  # time to close the connection to the scheduler
DIRECT = {"direct_to_workers": True}
_ONE_AT_A_TIME = Lock()


@dataclass(frozen=True)
class Answers:
    """Results of a unit up to its first error, and its run time."""

    results: list[Any]
    error: Exception | None
    seconds: float


@dataclass(frozen=True)
class Unit:
    """Pickled work for a worker; unpickling it calls `run_unit`, which does the work.

    A worker without this package can't unpickle its objects: it would lose its connection. Bytes it can read, and it
    returns the error.
    """

    job: bytes
    items: bytes
    version: str

    def __reduce__(self) -> tuple:
        return run_unit, (self.job, self.items, self.version)


def run_unit(job: bytes, items: bytes, version: str) -> Answers:
    """Process a unit on a worker; a worker with another version of surveysim returns an error before it unpickles
    anything."""
    if version != __version__:
        error = EngineError(f"a worker has surveysim {__version__}; {version} is expected")
        return Answers([], error, 0.0)
    keep_freed_memory()
    work, units = loads(job), loads(items)
    start, results = perf_counter(), []
    try:
        # A limit on threads is the process's: units of a worker of several threads would undo each other's.
        with _ONE_AT_A_TIME, threadpool_limits(1):
            for item in units:
                results.append(work(item))
    except Exception as error:  # whatever it is, the parent decides
        return Answers(results, sendable(error), perf_counter() - start)
    return Answers(results, None, perf_counter() - start)


def outlined(answers: Answers, outline: Callable[[Any], Any]) -> Answers:
    """Replace results by their outlines, on a worker."""
    return replace(answers, results=[outline(result) for result in answers.results])


def joined(one: Answers, other: Answers, join: Callable[[Any, Any], Any]) -> Answers:
    """Join two large results, on a worker."""
    return Answers([join(one.results[0], other.results[0])], None, 0.0)


class HeldResult:
    """A large result on the cluster, in a unit of its own."""

    def __init__(self, client: Client, future: Future, outline: Any, large: LargeResults) -> None:
        self._client, self._future, self._large, self.outline = client, future, large, outline

    def fetch(self) -> Any:
        """Get the result itself; EngineError if the cluster is gone or has no worker that could make it again."""
        with _lost_scheduler():
            while True:
                with suppress(TimeoutError):
                    return self._future.result(timeout=ANSWER_S).results[0]
                if not self._client.sync(self._client.scheduler.ncores, callback_timeout=ANSWER_S):
                    raise EngineError("the cluster has no worker that returns its sums")

    def joined(self, other: "HeldResult") -> "HeldResult":
        """Join two results on the cluster; EngineError if it is gone."""
        with _lost_scheduler():
            join = self._large.join
            future = self._client.submit(joined, self._future, other._future, join, pure=False)
            return HeldResult(self._client, future, self.outline + other.outline, self._large)


def on_cluster(
    job: Callable[[Any], Any], items: Items, engine: "Engine", large: LargeResults | None = None
) -> Generator[Answer]:
    """Yield the answer for each item from the workers of a scheduler or of this machine, as they come.

    Raises
    ------
    EngineError
        If the scheduler is gone or workers are lost repeatedly.
    """
    with _client(engine, items.left()) as client, _lost_scheduler():
        yield from _Units(client, job, items, large).answers()


class _Units:
    """Units of items in progress on a cluster, a few per worker."""

    def __init__(self, client: Client, job: Callable[[Any], Any], items: Items, large: LargeResults | None) -> None:
        self.client, self.items, self.large, self.watch = client, items, large, _Watch(client)
        self.name, self.job = uuid4().hex, pickle.dumps(job)
        self.numbers: dict[Future, list[int]] = {}  # of the items of each unit, by what comes back
        self.kept: dict[Future, Future] = {}  # large results, by their outlines
        self.finished: SimpleQueue[Future] = SimpleQueue()
        self.each_s: float | None = None

    def answers(self) -> Iterator[Answer]:
        """Yield the answers of all units as they come."""
        try:
            self._submit()
            while self.numbers:
                units = self._finished()
                for unit, found in zip(units, self._gathered(units), strict=True):
                    yield from self._answers_of(unit, found)
                self._submit()  # now that the answers are used: items may have waited for them
        finally:
            for unit in (*self.numbers, *self.kept.values()):
                unit.release()

    def _gathered(self, units: list[Future]) -> list[Answers]:
        """Get the answers of finished units; a worker may be lost with them, and they are made again."""
        gather = partial(self.client.gather, units, asynchronous=True)
        while True:
            with suppress(TimeoutError):  # only of this check: errors of the job are in its answers
                return self.client.sync(gather, callback_timeout=ANSWER_S)
            self.watch.workers()

    def _answers_of(self, unit: Future, found: Answers) -> Iterator[Answer]:
        """Yield the answers of a finished unit."""
        numbers, results = self.numbers.pop(unit), self._held(unit, found.results)
        unit.release()
        self.each_s = found.seconds / max(1, len(results))
        yield from ((number, result, None) for number, result in zip(numbers, results, strict=False))
        if found.error is not None:
            yield numbers[len(results)], None, found.error

    def _held(self, unit: Future, results: list[Any]) -> list[Any]:
        """Put large results, of which only the outline came back, in the place of the outline."""
        kept = self.kept.pop(unit, None)
        if kept is None or self.large is None:
            return results
        return [HeldResult(self.client, kept, outline, self.large) for outline in results]

    def _submit(self) -> None:
        """Submit units until each worker has a few."""
        there = max(1, self.watch.workers())
        while len(self.numbers) < TAKEN_AHEAD * there and (taken := self._take(there)):
            numbers, items = zip(*taken, strict=True)
            unit = Unit(self.job, pickle.dumps(items), __version__)
            key = f"surveysim-{self.name}-{numbers[0]}"
            future = self.client.submit(loads, pickle.dumps(unit), key=key, pure=False)
            if self._is_large(items[0]):
                whole, future = future, self.client.submit(outlined, future, self.large.outline, pure=False)
                self.kept[future] = whole
            self.numbers[future] = list(numbers)
            future.add_done_callback(self.finished.put)

    def _is_large(self, item: Any) -> bool:
        return self.large is not None and self.large.is_large(item)

    def _take(self, workers: int) -> list[tuple[int, Any]]:
        """Take the items of the next unit, which ends with the first that has a large result."""
        taken: list[tuple[int, Any]] = []
        size = unit_size(self.each_s, workers, self.items.left())
        while len(taken) < size and (item := self.items.take(workers)) is not None:
            taken.append(item)
            if self._is_large(item[1]):
                break
        return taken

    def _finished(self) -> list[Future]:
        """Wait for a unit that is finished, and take more of which outlines come back."""
        units: list[Future] = []
        while not units:
            with suppress(Empty):
                units.append(self.finished.get(timeout=LOOK_S))
                while units[-1] in self.kept and len(units) < OUTLINES:
                    units.append(self.finished.get_nowait())
            self.watch.workers()
        return units


class _Watch:
    """Waits for answers of a cluster for a limited time without workers or without answers of its scheduler."""

    def __init__(self, client: Client) -> None:
        self.client = client
        self.since: float | None = None  # there has been no worker
        self.said = 0.0
        self.there, self.counted = 0, -math.inf

    def workers(self) -> int:
        """Count the workers, once a second at most.

        Log a warning while there is none, and raise EngineError after `WAIT_S`.
        """
        now = monotonic()
        if now - self.counted < COUNT_EVERY_S and self.there:
            return self.there
        self.counted, self.there = now, len(self.client.sync(self.client.scheduler.ncores, callback_timeout=ANSWER_S))
        there = self.there
        if there:
            self.since = None
        elif self.since is None or now - self.said >= SAY_EVERY_S:
            self.since, self.said = self.since or now, now
            log.warning(f"the cluster has no worker; waiting for one, for {_hours(self.since + WAIT_S - now)} at most")
        elif now - self.since >= WAIT_S:
            raise EngineError(f"the cluster has had no worker for {_hours(WAIT_S)}")
        return there


def _hours(seconds: float) -> str:
    return f"{seconds / 3600:.1f} h" if seconds >= 3600 else f"{seconds:.0f} s"


def unit_size(each_s: float | None, workers: int, left: int) -> int:
    """Number of items in the next unit.

    Units are long enough for the scheduler to keep up, and short enough to keep all workers busy until the end.

    Parameters
    ----------
    each_s
        Measured time per item [s]; None before the first answer.
    workers
        Number of workers.
    left
        Number of items left.
    """
    if each_s is None:
        return 1
    wanted = max(UNIT_S, SCHEDULER_S * workers) / max(each_s, 1e-6)
    return int(max(1, min(wanted, MOST_ITEMS, left // (TAKEN_AHEAD * workers))))


def workers_of(scheduler: str) -> int:
    """Number of workers of a scheduler, at least 1; EngineError if it does not answer."""
    _say_losses_once()
    return max(1, schedulers.workers_at(address_of(scheduler)))


@contextmanager
def _client(engine: "Engine", items: int) -> Iterator[Client]:
    """Open a client of the scheduler, or of workers of this machine."""
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
    """Start workers on this machine; EngineError if that fails."""
    try:
        with ignore_sigint_in_children(), hide_main_module():
            # No memory limit: a worker that is over its share of the machine while others are not need not end.
            return LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                memory_limit=None,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
    except Exception as error:  # limits of the machine on files, processes or threads
        raise EngineError(f"engine 'dask': no workers can be started here ({schedulers.reason(error)})") from None


def _connected(scheduler: str) -> Client:
    """Connect a client to a scheduler by address or scheduler file; EngineError if none answers."""
    _say_losses_once()
    address, limit = address_of(scheduler), schedulers.CONNECT_S
    schedulers.workers_at(address)  # its own end is sure, which that of a client is not while it connects
    return schedulers.within(limit, address, lambda: Client(address, timeout=limit, set_as_default=False, **DIRECT))


def _say_losses_once() -> None:
    """Silence dask's tracebacks of lost workers: this engine reports them in one line."""
    for name in [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]:
        logging.getLogger(name).setLevel(logging.CRITICAL)


@contextmanager
def _lost_scheduler() -> Iterator[None]:
    """Convert errors of dask to EngineError with one line."""
    try:
        yield
    except KilledWorker:
        raise too_many_losses() from None
    except (ImportError, AttributeError) as error:
        raise EngineError(f"a worker can't load surveysim {__version__}: {schedulers.reason(error)}") from None
    except (CancelledError, OSError):  # closed connections, time-outs
        raise EngineError("the scheduler of the cluster is gone") from None
    except RuntimeError as error:  # a closed client, or a scheduler that cannot read the data
        raise EngineError(f"the cluster's scheduler failed: {schedulers.reason(error)}") from None
