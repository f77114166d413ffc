"""Engines: order, bounded waiting, errors, and signals that never leave a thing half done."""

import multiprocessing
import os
import signal
import threading
import time
from itertools import islice

import pytest
from threadpoolctl import threadpool_info

from surveysim.engines import WorkerLostError, held_back_signals, ordered_map


def square(item):
    time.sleep(0.02 * (item % 3 == 0))  # later items may be ready earlier
    return item, item**2, os.getpid()


def fail_at_three(item):
    if item == 3:
        raise ValueError(f"found {item}")
    return item


def vanish(item):
    os._exit(9)


def threads(item):
    return [(pool["user_api"], pool["num_threads"]) for pool in threadpool_info()]


def sleep_long(item):
    if item:
        time.sleep(60)
    return item


@pytest.mark.parametrize("workers", [1, 2])
def test_order(workers):
    results = list(ordered_map(square, range(20), workers))
    assert [item[:2] for item in results] == [(i, i**2) for i in range(20)]
    assert (os.getpid() in {item[2] for item in results}) == (workers == 1)


@pytest.mark.parametrize("workers", [1, 2])
def test_no_items(workers):
    assert list(ordered_map(square, [], workers)) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_few_items_are_taken_ahead(workers):
    taken = []
    results = ordered_map(square, (taken.append(i) or i for i in range(1000)), workers)
    assert [item[0] for item in islice(results, 4)] == [0, 1, 2, 3]
    assert len(taken) <= 4 + 3 * workers + 1
    results.close()
    assert len(taken) < 20


@pytest.mark.parametrize("workers", [1, 2])
def test_errors_pass_on(workers):
    results = ordered_map(fail_at_three, range(10), workers)
    assert [next(results) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(ValueError, match="found 3"):
        next(results)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("workers", [1, 2])
def test_one_blas_thread(workers):
    (pools,) = ordered_map(threads, [0], workers)
    assert all(number == 1 for api, number in pools if api == "blas")


def test_lost_worker():
    with pytest.raises(WorkerLostError):
        list(ordered_map(vanish, range(4), 2))
    assert not multiprocessing.active_children()


def test_closing_does_not_wait_for_work():
    results = ordered_map(sleep_long, range(8), 2)
    assert next(results) == 0
    begin = time.monotonic()
    results.close()
    assert time.monotonic() - begin < 10
    assert not multiprocessing.active_children()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_wait_for_the_end_of_a_block(number):
    events = []
    previous = signal.signal(number, lambda *_: events.append("signal"))
    try:
        with held_back_signals():
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
    with pytest.raises(ZeroDivisionError), held_back_signals():
        raise ZeroDivisionError
    assert signal.getsignal(signal.SIGINT) is before


def test_other_threads_hold_nothing_back():
    """Python handles signals in the main thread alone; elsewhere the block just runs."""
    done = []

    def work():
        with held_back_signals():
            done.append(True)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == [True]
