"""What a run of a scene would do, take and leave behind, predicted from one observation made here."""

import os
from dataclasses import dataclass
from time import perf_counter

from surveysim.coadds import CoAdds, empty_coadds
from surveysim.reduction import observe
from surveysim.results import stages_left_out
from surveysim.scan import samples_per_scan
from surveysim.setup import Setup, prepare, window_observations
from surveysim.sweep import Sweep

# What Python and the libraries hold before the first array, what drawing figures adds, and how many copies of
# its streams one observation's work takes.
BASE_BYTES = 230e6
FIGURE_BYTES = 80e6
WORKING_COPIES = 8
# The figures of a scored run take about three times as long as it takes to start.
FIGURE_STARTS = 3


@dataclass(frozen=True)
class Plan:
    """Stages that run with the reason for each left out, and the predicted cost."""

    stages: dict[str, str]
    left_out: dict[str, str]
    detector_samples: int
    wall_s: float
    memory_bytes: float
    output_bytes: float
    timestream_bytes: float


def make_plan(setup: Setup, workers: int, start_s: float = 0.0) -> Plan:
    """Predict by running one observation (twice: the first warms the caches) with and without window skies.

    `start_s` is the time that it took to start and to prepare `setup`; worker processes take it once more.
    """
    scene = setup.scene
    n_window = int(window_observations(scene).sum())
    seconds = {}
    for with_window in (False, True) if n_window else (False,):
        observe(setup, 0, with_window)
        start = perf_counter()
        observe(setup, 0, with_window)
        seconds[with_window] = perf_counter() - start
    total = (scene.observations - n_window) * seconds[False] + n_window * seconds.get(True, 0.0)
    samples = setup.n_det * setup.raster.n_scans * samples_per_scan(setup.raster)
    parallel = min(workers, scene.observations, os.cpu_count() or 1)
    starts = 1 + (parallel > 1) + FIGURE_STARTS * (scene.score is not None)
    coadds = empty_coadds(setup)
    maps = coadds.sums.nbytes + coadds.weight.nbytes + coadds.hits.nbytes
    return Plan(
        stages=_stages(setup, n_window),
        left_out={name: f"no section [{name}]" for name in stages_left_out(scene)},
        detector_samples=samples * scene.observations,
        wall_s=starts * start_s + total / parallel,
        memory_bytes=BASE_BYTES + FIGURE_BYTES + _bytes(coadds) + 4 * samples * WORKING_COPIES,
        output_bytes=0.6 * maps + 400 * scene.observations,
        timestream_bytes=4.0 * samples * scene.observations,
    )


@dataclass(frozen=True)
class SweepPlan:
    """The predicted cost of all points of a sweep."""

    n_points: int
    detector_samples: int
    wall_s: float
    memory_bytes: float


def make_sweep_plan(sweep: Sweep, workers: int, start_s: float = 0.0) -> SweepPlan:
    """Predict from the first and the last point: the others take as long for each of their detector-samples.

    `start_s` as in `make_plan`; points are prepared once more where they run.
    """
    ends = [sweep.points[number] for number in sorted({0, len(sweep.points) - 1})]
    plans = [make_plan(prepare(point.scene), 1) for point in ends]
    seconds_each = sum(plan.wall_s for plan in plans) / sum(plan.detector_samples for plan in plans)
    work = [point.detector_samples * seconds_each for point in sweep.points]
    parallel = min(workers, len(work), os.cpu_count() or 1)
    starts = 1 + (parallel > 1)
    return SweepPlan(
        n_points=len(work),
        detector_samples=sum(point.detector_samples for point in sweep.points),
        wall_s=starts * start_s + max(max(work), sum(work) / parallel),
        memory_bytes=max(plan.memory_bytes for plan in plans),
    )


def _bytes(coadds: CoAdds) -> int:
    arrays = (coadds.sums, coadds.weight, coadds.hits, coadds.flipped, coadds.window, coadds.window_weight)
    return sum(array.nbytes for array in arrays)


def _stages(setup: Setup, n_window: int) -> dict[str, str]:
    scene = setup.scene
    n_det = setup.n_det
    scans = f"{scene.observations} observations of {setup.raster.n_scans} scans"
    stages = {"pointing": f"{scans}, {n_det} detectors, {scene.scan.sample_rate_hz:g} Hz"}
    for name in ("atmosphere", "excess", "photon", "detector", "sky"):
        if getattr(scene, name) is not None:
            stages[name] = "streams"
    stages["cleaning"] = ", ".join(recipe.label for recipe in setup.whole_recipes)
    stages["maps"] = f"{setup.geometry.n_x} x {setup.geometry.n_y} pixels"
    if scene.score:
        stages["data sets"] = ", ".join(setup.data_sets)
        stages["window"] = f"{scene.score.window.skies} skies through {n_window} observations"
        stages["score"] = f"multipoles {scene.score.ell_min} to {scene.score.ell_max}"
    return stages
