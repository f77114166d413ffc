"""Measure the first process and dask's scheduler with many workers whose observations take time but no work.

``python tests/benchmark/many_workers.py [WORKERS ...]`` prints a row for each number of workers: 10, 100, 1000. A few
processes host all workers, so that a small machine can have a thousand. CPU times of the first process, of the
scheduler and of all hosts tell which of them limits the rate: an event loop that takes 0.1 ms an observation handles
10,000 a second. Sleeps are long enough for one machine to host them all.
"""

import asyncio
import contextlib
import logging
import multiprocessing
import sys
import time
from dataclasses import dataclass

import psutil

import surveysim.runtime.dask_cluster as dask_cluster
from surveysim.runtime.engine import Engine, EngineError, unordered_map
from surveysim.runtime.items import LargeResults
from surveysim.survey.remote_node import NodeOutline
from surveysim.survey.spans import Span, Spans

OBSERVATION_S = 0.0625  # of a Bolocam observation, by which the sizes of spans are chosen
OBSERVATIONS = 128  # a worker
RATE = 800  # most observations a second: one machine hosts all processes, and sleeps are longer where it could not
A_PROCESS = 125  # workers


@dataclass(frozen=True)
class Slept:
    """Observations that took time."""

    outline: NodeOutline


@dataclass(frozen=True)
class Sleep:
    """The task of a worker: sleep for each observation of a span."""

    each_s: float

    def __call__(self, span: Span) -> Slept:
        """Sleep, and tell the time of Bolocam's observations."""
        n_obs = span.end - span.first
        time.sleep(n_obs * self.each_s)
        return Slept(NodeOutline(span.first, n_obs, n_obs * OBSERVATION_S))


def outline(slept: Slept) -> NodeOutline:
    """Outline of a result."""
    return slept.outline


def join(one: Slept, other: Slept) -> Slept:
    """Join two results."""
    return Slept(one.outline + other.outline)


def is_large(span: Span) -> bool:
    """Return whether a span has several observations."""
    return span.end - span.first > 1


def host(address: str, n_workers: int) -> None:
    """Host workers of a scheduler in this process until it ends."""
    from distributed import Worker

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    dask_cluster._ONE_AT_A_TIME = contextlib.nullcontext()  # nothing is computed here

    async def work() -> None:
        workers = [Worker(address, nthreads=1, dashboard=False, memory_limit=0) for _ in range(n_workers)]
        await asyncio.gather(*workers)
        await asyncio.gather(*(worker.finished() for worker in workers))

    with contextlib.suppress(Exception):
        asyncio.run(work())


def schedule(pipe) -> None:
    """Run a scheduler in this process; its address goes through the pipe."""
    from distributed import Scheduler

    async def serve() -> None:
        async with Scheduler(port=0, dashboard=False) as scheduler:
            pipe.send(scheduler.address)
            await scheduler.finished()

    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    asyncio.run(serve())


def are_there(engine: Engine, n_workers: int) -> bool:
    """Return whether all workers have joined; a scheduler that they all join at once may be late with its answer."""
    with contextlib.suppress(EngineError):
        return engine.workers_for(10**6) >= n_workers
    return False


def cpu_s(process: multiprocessing.process.BaseProcess) -> float:
    """CPU time of a process so far [s]."""
    times = psutil.Process(process.pid).cpu_times()
    return times.user + times.system


def measure(n_workers: int) -> str:
    """Run observations on a cluster of so many workers and describe it in a row."""
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    crew = [context.Process(target=schedule, args=(theirs,), daemon=True)]
    crew[0].start()
    address = ours.recv()
    for first in range(0, n_workers, A_PROCESS):
        crew.append(context.Process(target=host, args=(address, min(A_PROCESS, n_workers - first)), daemon=True))
        crew[-1].start()
    engine = Engine("dask", scheduler=address)
    while not are_there(engine, n_workers):
        time.sleep(2)
    n_obs, each_s = n_workers * OBSERVATIONS, max(OBSERVATION_S, n_workers / RATE)
    spans, nodes, joins = Spans(list(range(n_obs)), single=False), {}, 0
    start, cpu, before = time.perf_counter(), time.process_time(), [cpu_s(process) for process in crew]
    for _, result in unordered_map(Sleep(each_s), spans, engine, LargeResults(is_large, outline, join)):
        item = result.outline
        spans.measured(item.seconds / item.done)
        if isinstance(result, Slept):
            continue
        node = result
        while (other := nodes.pop(node.outline.first ^ node.outline.done, None)) is not None:
            if other.outline.done != node.outline.done:
                nodes[other.outline.first] = other
                break
            left, right = sorted((node, other), key=lambda held: held.outline.first)
            node, joins = left.joined(right), joins + 1
        nodes[node.outline.first] = node
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    scheduler, *hosts = [cpu_s(process) - earlier for process, earlier in zip(crew, before, strict=True)]
    nodes.clear()
    for process in crew[::-1]:
        process.kill()
    ideal = OBSERVATIONS * each_s
    each = "".join(f"{1e3 * seconds / n_obs:14.3f}" for seconds in (cpu, scheduler, sum(hosts)))
    return f"{n_workers:8d} {n_obs:13d} {wall:9.1f} {ideal / wall:11.2f} {each} {joins:8d}"


if __name__ == "__main__":
    print(" workers  observations  wall [s]  efficiency  first process     scheduler         hosts    joins")
    print("                                                CPU time [ms an observation]")
    for number in [int(text) for text in sys.argv[1:]] or [10, 100, 1000]:
        print(measure(number), flush=True)
