"""Times of a survey by number of workers: ``python -m tests.benchmark.workers [SCENE] [OBSERVATIONS] [REPEATS]``.

A table of simulation and sums alone, without the start of the program and its figures, but with that of the workers.
What the first process does of each observation, its sums, no worker can take from it: it ends what more workers bring.
"""

import sys
from pathlib import Path
from statistics import median
from time import perf_counter, process_time

from surveysim import Engine, load_scene
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import default_workers
from surveysim.survey.run import run_observations

LYNX = Path(__file__).parents[2] / "scenarios" / "lynx.toml"


def measure(scene, engine: Engine) -> tuple[float, float]:
    """Wall time [s], and CPU time of the first process [s], of a survey."""
    setup = prepare(scene)
    wall, cpu = perf_counter(), process_time()
    run_observations(setup, None, engine)
    return perf_counter() - wall, process_time() - cpu


def main(path: str = str(LYNX), observations: str = "500", repeats: str = "3") -> None:
    """Print wall time, speed-up over one process, and the first process' time an observation."""
    scene, cores = load_scene(path, {"observations": int(observations)}), default_workers()
    crews = [Engine("serial"), *(Engine(kind, cores) for kind in ("processes", "dask"))]
    run_observations(prepare(scene.model_copy(update={"observations": 2})), None)  # compiles
    times = {engine: [] for engine in crews}
    for _ in range(int(repeats)):
        for engine in crews:  # in turn, so that all feel what else the machine does
            times[engine].append(measure(scene, engine))
    alone = median(wall for wall, _ in times[crews[0]])
    print("| engine | workers | wall [s] | speed-up | first process [ms an observation] |\n|---|---:|---:|---:|---:|")
    for engine, pairs in times.items():
        wall, cpu = (median(values) for values in zip(*pairs, strict=True))
        each = 1e3 * cpu / scene.observations
        print(f"| {engine.kind} | {engine.workers or 1} | {wall:.1f} | {alone / wall:.2f} | {each:.2g} |")


if __name__ == "__main__":
    main(*sys.argv[1:])
