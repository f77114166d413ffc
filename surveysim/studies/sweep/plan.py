"""Predicted cost of a sweep, from its first and last points."""

import os
from dataclasses import dataclass

from surveysim.reduction.setup import prepare
from surveysim.studies.resources import make_plan
from surveysim.studies.sweep.axes import Sweep


@dataclass(frozen=True)
class SweepPlan:
    """Predicted cost of a sweep: detector-samples, run time [s], memory of the largest process [bytes]."""

    n_points: int
    detector_samples: int
    wall_s: float
    memory_bytes: float


def make_sweep_plan(sweep: Sweep, workers: int, start_s: float = 0.0) -> SweepPlan:
    """Predict the cost of a sweep from its first and last points, in proportion to detector-samples.

    Parameters
    ----------
    sweep
    workers
        Worker processes.
    start_s
        CPU time [s] of the start, as for `make_plan`; points are prepared once more where they run.
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
