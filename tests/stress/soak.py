"""Memory, descriptors, processes and files of long runs: `observations|runs NUMBER`; prints figures as JSON."""

import gc
import json
import os
import resource
import sys
import tempfile
from pathlib import Path

from surveysim import Engine, load_scene, run
from surveysim.runtime.engine import SERIAL
from surveysim.survey import run as survey
from tests.scenes import SMALL_SCENE

# Short scans of the small camera: a few milliseconds an observation.
QUICK = {"scan.duration": "3 s", "scan.scans": 3, "instrument.layout.rings": 1, "instrument.layout.dead": []}


def resident_mb() -> float:
    """Memory of this process now."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def state(temporary: Path) -> dict[str, float]:
    """Memory, open descriptors, children and temporary files."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return {
        "mb": resident_mb(),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "children": len(children),
        "temporary": len(list(temporary.rglob("*"))),
    }


def main() -> None:
    """Measure at a tenth and at the end of one run's observations, or after two fifths and all of many runs."""
    what, number = sys.argv[1], int(sys.argv[2])
    with tempfile.TemporaryDirectory() as folder:
        root, temporary = Path(folder), Path(folder) / "temporary"
        temporary.mkdir()
        tempfile.tempdir = os.environ["TMPDIR"] = str(temporary)
        (root / "scene.toml").write_text(SMALL_SCENE.replace("mask_separation_f_lambda = 1.3\n", ""))
        found = of_observations(root, number) if what == "observations" else of_runs(root, number)
    print(json.dumps(found))


def of_observations(root: Path, number: int) -> list[dict[str, float]]:
    """Measure during one run, which writes checkpoints from the start: they load a library of their own."""
    survey.CHECKPOINT_SECONDS = 0.5
    scene = load_scene(root / "scene.toml", QUICK | {"observations": number})
    found = []

    def look(coadds) -> None:
        if coadds.done in (number // 10, number):
            found.append(state(root / "temporary"))

    run(scene, root / "out", engine=SERIAL, figures=False, progress=look)
    return found


def of_runs(root: Path, number: int) -> list[dict[str, float]]:
    """Measure after two fifths and all of many runs, every tenth with figures and every tenth with workers.

    The first measurement comes after the first run with workers: Python starts a process for their semaphores.
    """
    scene = load_scene(root / "scene.toml", QUICK | {"observations": 4})
    found = []
    for place in range(1, number + 1):
        engine = SERIAL if place % 10 else Engine(workers=2)
        run(scene, root / "out", engine=engine, figures=place % 10 == 5)
        if place in (2 * number // 5, number):
            found.append(state(root / "temporary"))
    return found


if __name__ == "__main__":
    main()
