"""The lock of an output directory: one holder, taken over from a process that is gone."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import pytest

from surveysim.output import lock as output_lock
from surveysim.output.lock import LOCK, OutputError, alive, locked

CHILD = """
import sys, time
from pathlib import Path
from surveysim.output.lock import locked
with locked(Path(sys.argv[1])):
    print("locked", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    """Another process that holds the lock of the directory."""
    process = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "locked\n"
    yield process
    process.kill()
    process.communicate()


def left(tmp_path, **changes):
    """A lock that a job left there, in place of ours."""
    content = output_lock._holder() | changes
    (tmp_path / LOCK).write_text(json.dumps(content))
    return content


def test_a_directory_in_use(tmp_path, holder, caplog):
    """The line names the process; when that is killed, the next one says that it takes its place."""
    name = (tmp_path / LOCK).read_bytes()
    words = rf"in use by process {holder.pid} of host \S+ since 20.*; wait for its end"
    with pytest.raises(OutputError, match=words), locked(tmp_path):
        pytest.fail("both")
    assert (tmp_path / LOCK).read_bytes() == name and [path.name for path in tmp_path.iterdir()] == [LOCK]
    holder.send_signal(signal.SIGKILL)  # a zombie, as nobody has waited for it
    while alive(holder.pid):
        time.sleep(0.01)
    with locked(tmp_path):
        assert len(caplog.messages) == 1 and f"was in use by process {holder.pid} of host" in caplog.messages[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt, SystemExit])
def test_the_lock_goes_with_whatever_ends_the_block(tmp_path, error):
    with pytest.raises(error), locked(tmp_path):
        raise error
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "changes",
    [
        {"pid": 2**30},
        {"age": "12"},  # another process has this number now
        {"boot": "of before", "pid": 1, "age": ""},
    ],
)
def test_locks_of_processes_that_are_gone(tmp_path, changes, caplog):
    left(tmp_path, **changes)
    with locked(tmp_path):
        assert json.loads((tmp_path / LOCK).read_text())["pid"] == os.getpid()
    assert "this job takes its place" in caplog.text and not list(tmp_path.iterdir())


@pytest.mark.parametrize("changes", [{"host": "elsewhere"}, {"machine": "another"}, {"processes": "of a container"}])
def test_locks_that_can_not_be_judged_from_here(tmp_path, changes):
    """Of another machine or container, even where a process here has that number or none has."""
    left(tmp_path, pid=2**30, **changes)
    before = (tmp_path / LOCK).read_bytes()
    with pytest.raises(OutputError, match=f"if that process is gone delete {tmp_path / LOCK}"), locked(tmp_path):
        pytest.fail("both")
    assert (tmp_path / LOCK).read_bytes() == before


@pytest.mark.parametrize("content", [b"", b"\0\xff", b"[]", b'{"pid": 1}', b"[" * 5000, b'{"pid": "x"}', b"1" * 20_000])
def test_locks_that_can_not_be_read(tmp_path, content, monkeypatch):
    monkeypatch.setattr(output_lock, "_READ_AGAIN_S", 0.001)
    (tmp_path / LOCK).write_bytes(content)
    with pytest.raises(OutputError, match="a lock that can't be read; delete it if no job"), locked(tmp_path):
        pytest.fail("both")
    assert (tmp_path / LOCK).read_bytes() == content


def test_control_characters_of_a_lock_stay_in_it(tmp_path):
    left(tmp_path, host="\x1b[31mred\n" * 100)
    with pytest.raises(OutputError) as error, locked(tmp_path):
        pytest.fail("both")
    assert "\x1b" not in str(error.value) and len(str(error.value).splitlines()) == 1


def test_without_hard_links(tmp_path, monkeypatch):
    def no_links(*arguments):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", no_links)
    with locked(tmp_path), pytest.raises(OutputError, match="in use"), locked(tmp_path):
        pytest.fail("both")
    assert not list(tmp_path.iterdir())


def test_a_lock_that_was_replaced_is_not_removed(tmp_path):
    with locked(tmp_path):
        other = left(tmp_path, host="elsewhere")
    assert json.loads((tmp_path / LOCK).read_text()) == other


def test_threads_of_one_process(tmp_path):
    """Exactly one of twenty has it at a time; all that have had it leave nothing behind."""
    inside, most, refused = [], [], []

    def job():
        try:
            with locked(tmp_path):
                inside.append(1)
                most.append(len(inside))
                time.sleep(0.01)
                inside.pop()
        except OutputError:
            refused.append(1)

    jobs = [threading.Thread(target=job) for _ in range(20)]
    for item in jobs:
        item.start()
    for item in jobs:
        item.join()
    assert max(most) == 1 and len(most) + len(refused) == 20 and not list(tmp_path.iterdir())


def _take(directory, barrier, results):
    barrier.wait()
    try:
        with locked(directory):
            results.put("locked")
            barrier.wait()  # until all have tried
    except OutputError:
        results.put("refused")
        barrier.wait()


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="starts processes by fork")
def test_jobs_that_start_at_once(tmp_path):
    """Exactly one has the lock, though all find that of a process that is gone."""
    context = multiprocessing.get_context("fork")
    for number in range(4):
        directory = tmp_path / str(number)
        directory.mkdir()
        left(directory, pid=2**30)
        barrier, results = context.Barrier(4), context.SimpleQueue()
        jobs = [context.Process(target=_take, args=(directory, barrier, results)) for _ in range(4)]
        for job in jobs:
            job.start()
        found = sorted(results.get() for _ in jobs)
        for job in jobs:
            job.join(20)
        assert found == ["locked", "refused", "refused", "refused"] and not list(directory.iterdir())
