"""Each input in a forked process: a crash, a hang or a growth of memory of one ends that one alone.

The server imports the program and prepares what the inputs are mangled from once; a fork then costs milliseconds. It
must therefore be a process without threads: the tests start it as a command.
"""

import contextlib
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from tests.fuzz.outcomes import Outcome, Silent, last_frame

# Kind: number of inputs of 100.
KINDS = {
    "scenes": 38,
    "sweeps": 6,
    "tables": 10,
    "descriptions": 6,
    "streams": 12,
    "maps": 10,
    "formats": 8,
    "checkpoints": 5,
    "points": 4,
    "summaries": 6,
    "commands": 9,
}
CPU_S, IDLE_S, WALL_S = 20, 20, 120  # of one input; where others use the machine too, the clock alone says little
MEMORY_BYTES = 2 * 10**9
JOBS = 2


@dataclass
class Trial:
    """An input that is being tried."""

    kind: str
    number: int
    pid: int
    pipe: int
    folder: Path
    started: float


def shares(number: int, kinds: tuple[str, ...] = tuple(KINDS)) -> list[tuple[str, int]]:
    """(kind, number of input) of so many inputs of all kinds, at least one of each."""
    total = sum(KINDS[kind] for kind in kinds)
    counts = {kind: max(1, round(number * KINDS[kind] / total)) for kind in kinds}
    return [(kind, place) for kind in kinds for place in range(counts[kind])]


def serve(tasks: list[tuple[str, int]], seed: int, root: Path) -> Iterator[dict[str, Any]]:
    """Try inputs; yields a record of each: kind, number, outcome, text, input, seconds and most memory."""
    modules, bases = {}, {}
    for kind in dict.fromkeys(kind for kind, _ in tasks):
        modules[kind] = import_module(f"tests.fuzz.{kind}")
        folder = root / f"base-{kind}"
        folder.mkdir()
        bases[kind] = modules[kind].prepare(folder)
    waiting, running = list(reversed(tasks)), {}
    while waiting or running:
        while waiting and len(running) < JOBS:
            kind, number = waiting.pop()
            trial = _start(modules[kind], bases[kind], kind, number, seed, root)
            running[trial.pid] = trial
        time.sleep(0.002)
        for trial in list(running.values()):
            if record := _ended(trial):
                del running[trial.pid]
                yield record


def _start(module: ModuleType, base: Any, kind: str, number: int, seed: int, root: Path) -> Trial:
    folder = root / f"{kind}-{number}"
    folder.mkdir()
    reading, writing = os.pipe()
    pid = os.fork()
    if pid:
        os.close(writing)
        return Trial(kind, number, pid, reading, folder, time.monotonic())
    try:
        os.setsid()
        os.close(reading)
        for signal_number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(signal_number, signal.SIG_DFL)
        os.chdir(folder)
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S + 1))
        allowed = _address_space() + MEMORY_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))
        outcome = _tried(module, base, np.random.default_rng([seed, *kind.encode(), number]), writing)
        _tell(writing, {"outcome": outcome.kind, "text": outcome.text})
    finally:
        os._exit(0)


def _address_space() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _tried(module: ModuleType, base: Any, rng: np.random.Generator, pipe: int) -> Outcome:
    try:
        label, attempt = module.mangled(base, rng)
    except Exception:
        return Outcome("harness", traceback.format_exc()[-1500:])
    _tell(pipe, {"input": label[:1500]})
    try:
        return attempt()
    except Silent as silent:
        return Outcome("silent", str(silent)[:600])
    except MemoryError:
        return Outcome("memory", last_frame(traceback.format_exc()))
    except BaseException:
        text = traceback.format_exc()
        ours = "/surveysim/" in text or "/mapmaker/" in text
        return Outcome("traceback", last_frame(text)) if ours else Outcome("harness", text[-1500:])


def _tell(pipe: int, record: dict[str, Any]) -> None:
    os.write(pipe, (json.dumps(record) + "\n").encode())


def _ended(trial: Trial) -> dict[str, Any] | None:
    """The record of a trial that has ended, or has taken too long; None of one that goes on."""
    taken = time.monotonic() - trial.started
    slow = taken > WALL_S or taken > IDLE_S and _cpu_s(trial.pid) < 0.5
    if slow:
        _end_group(trial.pid)
    pid, status, used = os.wait4(trial.pid, 0 if slow else os.WNOHANG)
    if not pid:
        return None
    _end_group(trial.pid)  # whatever it started
    with os.fdopen(trial.pipe, "rb") as pipe:
        told = {}
        for line in pipe.read().decode().splitlines():
            told |= json.loads(line)
    shutil.rmtree(trial.folder, ignore_errors=True)
    record = {"kind": trial.kind, "number": trial.number, "input": "", "text": ""} | told
    record |= {"cpu_s": round(used.ru_utime + used.ru_stime, 3), "peak_mb": used.ru_maxrss // 1000}
    if slow or os.WIFSIGNALED(status) and os.WTERMSIG(status) in (signal.SIGXCPU, signal.SIGKILL):
        record |= {"outcome": "hang", "text": f"more than {CPU_S} CPU seconds, {IDLE_S} idle ones or {WALL_S} s"}
    elif os.WIFSIGNALED(status):
        record |= {"outcome": "traceback", "text": f"ended by {signal.Signals(os.WTERMSIG(status)).name}"}
    elif "outcome" not in told:
        record |= {"outcome": "traceback", "text": "the process ended by itself"}
    elif used.ru_maxrss * 1024 > MEMORY_BYTES:
        record["outcome"] = "memory"
    return record


def _cpu_s(group: int) -> float:
    """CPU time of the processes of a group."""
    ticks = 0
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            fields = entry.read_text().rpartition(")")[2].split()
            ticks += sum(map(int, fields[11:15])) if int(fields[2]) == group else 0
    return ticks / os.sysconf("SC_CLK_TCK")


def _end_group(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)


def main() -> None:
    """Print a record a line: `KIND|all NUMBER SEED [FIRST]`."""
    kind, number, seed, *first = sys.argv[1:]
    start = int(first[0]) if first else 0
    tasks = shares(int(number)) if kind == "all" else [(kind, place) for place in range(start, start + int(number))]
    with tempfile.TemporaryDirectory(prefix="fuzz-") as root:
        for record in serve(tasks, int(seed), Path(root)):
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
