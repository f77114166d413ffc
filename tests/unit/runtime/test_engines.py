"""Engines: order, bounded waiting, errors, workers that are lost, and signals that never leave a thing half done."""

import multiprocessing
import os
import re
import signal
import threading
import time
from itertools import islice

import pytest
from distributed import LocalCluster
from threadpoolctl import threadpool_info

from surveysim.runtime.dask_cluster import MOST_ITEMS, SCHEDULER_S, UNIT_S, on_cluster, run_unit, unit_size
from surveysim.runtime.engine import SERIAL, Engine, EngineError, defer_signals, ordered_map, unordered_map
from surveysim.runtime.items import InOrder

TWO = Engine(workers=2)
DASK = Engine("dask", workers=2)
ALL = pytest.mark.parametrize("engine", [SERIAL, TWO, DASK], ids=lambda engine: engine.kind)
SLOW_DASK = pytest.param(DASK, marks=pytest.mark.slow)
LOCAL = pytest.mark.parametrize("engine", [TWO, SLOW_DASK], ids=lambda engine: engine.kind)


@pytest.fixture(scope="module")
def on_a_cluster():
    """Dask on a cluster that is there: its workers are threads of this process, which start in no time."""
    how = {"processes": False, "protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    with LocalCluster(2, threads_per_worker=1, **how) as cluster:
        yield Engine("dask", scheduler=cluster.scheduler_address)


@pytest.fixture(params=["serial", "processes", "dask"])
def each(request):
    """Each engine; dask makes no cluster of its own, which takes a second."""
    return {"serial": SERIAL, "processes": TWO}.get(request.param) or request.getfixturevalue("on_a_cluster")


def square(item):
    time.sleep(0.02 * (item % 3 == 0))  # later items may be ready earlier
    return item, item**2, os.getpid()


def observed(item):
    """The square, and the threads that BLAS may use; the 21st fails."""
    if item == 20:
        raise ValueError(f"found {item}")
    return *square(item), [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def vanish(item):
    """Ends the worker that has the first item: of two items, two workers are asked for."""
    if item == 0:
        os._exit(9)
    return item


class VanishOnce:
    """A worker that has `item` is killed the first time; others stay."""

    def __init__(self, item, folder):
        self.item, self.mark = item, folder / "gone"

    def __call__(self, item):
        if item == self.item and not self.mark.exists():
            self.mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return item**2


def sleep_long(item):
    if item:
        time.sleep(60)
    return item


@ALL
def test_order_errors_and_threads(engine, two_threads):
    """All engines keep the order, pass errors on and give BLAS one thread."""
    results = ordered_map(observed, range(30), engine)
    found = [next(results) for _ in range(20)]
    assert [item[:2] for item in found] == [(i, i**2) for i in range(20)]
    assert (os.getpid() in {item[2] for item in found}) == (engine is SERIAL)
    assert all(number == 1 for *_, pools in found for number in pools)
    with pytest.raises(ValueError, match="found 20"):
        next(results)
    assert list(ordered_map(square, [], engine)) == []
    assert not multiprocessing.active_children()


def test_all_answers_without_order(each):
    assert sorted(unordered_map(square_alone, InOrder(range(40), position=40), each)) == [(i, i**2) for i in range(40)]


def square_alone(item):
    return square(item)[1]


class OneAtATime(InOrder):
    """Items that are handed out once all before are answered."""

    def take(self, workers):
        return None if self.taken > self.position else super().take(workers)


def test_items_that_wait_for_answers_are_all_handed_out(each):
    source, found = OneAtATime(range(3)), []
    for answer in unordered_map(square_alone, source, each):
        source.position += 1
        found.append(answer)
    assert found == [(0, 0), (1, 1), (2, 4)]


def test_the_first_error_is_raised_when_work_in_progress_is_finished(each):
    found = []
    with pytest.raises(ValueError, match="found 3$"):
        for number, _ in unordered_map(fails_late_or_early, InOrder(range(10**6), position=10**6), each):
            found.append(number)
    assert {0, 1, 2} <= set(found) and len(found) < 10**6


def fails_late_or_early(item):
    if item == 3:
        time.sleep(0.3)
    if item in (3, 4):
        raise ValueError(f"found {item}")
    return item


@pytest.mark.parametrize("engine", [SERIAL, TWO], ids=lambda engine: engine.kind)
def test_few_items_are_taken_ahead(engine):
    class Items(list):
        def __getitem__(self, item):
            taken.append(item)
            return super().__getitem__(item)

    taken, items = [], Items(range(1000))
    results = ordered_map(square, items, engine)
    assert [item[0] for item in islice(results, 4)] == [0, 1, 2, 3]
    results.close()
    assert len(taken) <= 4 + 3 * 2 + 1


@LOCAL
def test_work_of_a_lost_worker_is_done_again(engine, tmp_path, caplog):
    results = list(ordered_map(VanishOnce(5, tmp_path), range(12), engine))
    assert results == [i**2 for i in range(12)] and (tmp_path / "gone").exists()
    assert ("its work is done again" in caplog.text) == (engine is TWO)  # dask does it by itself
    assert not multiprocessing.active_children()


@LOCAL
def test_work_that_ends_every_worker(engine):
    how = "the last with exit code 9" if engine is TWO else "perhaps killed because memory ran out"  # by dask
    with pytest.raises(EngineError, match=f"3 worker processes were lost with the same work, {how}"):
        list(ordered_map(vanish, range(2), engine))
    assert not multiprocessing.active_children()


@LOCAL
def test_closing_does_not_wait_for_work(engine):
    results = ordered_map(sleep_long, range(8), engine)
    assert next(results) == 0
    begin = time.monotonic()
    results.close()
    assert time.monotonic() - begin < 10
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("each_s", [None, 1e-9, 1e-3, 0.05, 0.5, 20.0])
@pytest.mark.parametrize("workers", [1, 2, 40, 1000])
@pytest.mark.parametrize("left", [1, 10, 500, 100_000])
def test_units(each_s, workers, left):
    """Long enough for the scheduler, unless that would leave workers idle or results heavy."""
    size = unit_size(each_s, workers, left)
    assert 1 <= size <= min(left, MOST_ITEMS)
    enough = each_s is not None and size * each_s > max(UNIT_S, workers * SCHEDULER_S) - each_s
    assert enough or each_s is None or size == MOST_ITEMS or size == max(1, left // (2 * workers))


def test_units_of_another_version_are_refused():
    answers = run_unit(b"of another version", b"", "0.0.0")  # which this one can't read
    assert answers.results == [] and isinstance(answers.error, EngineError)
    assert "a worker has surveysim" in str(answers.error) and "; 0.0.0 is expected" in str(answers.error)


@pytest.mark.parametrize(
    "choice, words",
    [
        (("threads",), "engine: found 'threads'; serial, processes, dask are there"),
        (("processes", 0), "workers: found 0; 1 or more is expected"),
        (("processes", 2, "tcp://host:8786"), "scheduler: found one for the engine 'processes'; only 'dask' has one"),
        (("dask", 2, "tcp://host:8786"), "workers: found a number and a scheduler"),
    ],
)
def test_engines_that_make_no_sense(choice, words):
    with pytest.raises(ValueError, match=words):
        Engine(*choice)


def test_schedulers_that_are_not_there(monkeypatch, tmp_path):
    monkeypatch.setattr("surveysim.runtime.dask_scheduler.CONNECT_S", 0.5)
    (tmp_path / "text").write_text("no scheduler")
    for path in ("nowhere.json", tmp_path / "text"):
        with pytest.raises(
            EngineError, match="neither an address nor a scheduler's file; tcp://host:port, tls://host:port"
        ):
            list(on_cluster(square, InOrder([1]), Engine("dask", scheduler=str(path))))
    with pytest.raises(EngineError, match="scheduler: no scheduler answers at tcp://127.0.0.1:9"):
        list(on_cluster(square, InOrder([1]), Engine("dask", scheduler="tcp://127.0.0.1:9")))


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_wait_for_the_end_of_a_block(number):
    events = []
    previous = signal.signal(number, lambda *_: events.append("signal"))
    try:
        with defer_signals():
            signal.raise_signal(number)
            signal.raise_signal(number)
            events.append("block")
        assert events == ["block", "signal"]
        signal.raise_signal(number)
        assert len(events) == 3
    finally:
        signal.signal(number, previous)


def test_errors_leave_the_handlers_as_they_were():
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(ZeroDivisionError), defer_signals():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is before


def test_other_threads_hold_nothing_back():
    """Python handles signals in the main thread alone; elsewhere the block just runs."""
    done = []

    def work():
        with defer_signals():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]


def test_quick_work_stays_in_this_process_unless_workers_are_asked_for():
    assert Engine().for_work(quick=True) == Engine(workers=1)
    for engine in (TWO, DASK, SERIAL, Engine("dask")):
        assert engine.for_work(quick=True) == engine
    assert Engine().for_work(quick=False) == Engine()


def test_a_fork_server_that_is_gone_is_one_line(monkeypatch):
    def lost(process):
        raise EOFError("unexpected EOF")

    monkeypatch.setattr("multiprocessing.context.ForkServerProcess.start", lost)
    with pytest.raises(EngineError, match="the process that starts workers is gone"):
        list(ordered_map(square_alone, range(4), Engine("processes", workers=2)))


class TwoArgumentsError(Exception):
    """Can be pickled, but not made again."""

    def __init__(self, what, where):
        super().__init__(f"{what} at {where}")


class LockedError(Exception):
    """Can't be pickled."""

    def __init__(self, text):
        super().__init__(text)
        self.lock = threading.Lock()


def answers_with_a_lambda(item):
    return lambda: item


def raises_two(item):
    raise TwoArgumentsError("noise", item)


def raises_locked(item):
    raise LockedError("locked")


@pytest.mark.parametrize(
    "job, words, note",
    [
        (raises_two, "TwoArgumentsError: noise at 0", "can't be sent by a worker: .* missing 1 required"),
        (raises_locked, "LockedError: locked", "can't be sent by a worker: cannot pickle"),
        (answers_with_a_lambda, "lambda", "a result of type function can't be sent by a worker"),
    ],
)
def test_answers_that_can_not_be_sent_say_why(request, job, words, note):
    """And no worker is lost with them. Dask sends a lambda."""
    kinds = [TWO] if job is answers_with_a_lambda else [TWO, request.getfixturevalue("on_a_cluster")]
    for engine in kinds:
        with pytest.raises(Exception, match=words) as caught:
            list(ordered_map(job, range(2), engine))
        assert re.search(note, caught.value.__notes__[0])
