"""Options of `run` that sweeps take or refuse, and the point that --point selects."""

from pathlib import Path
from typing import TYPE_CHECKING

from surveysim.cli.options import fail

if TYPE_CHECKING:
    from surveysim.reduction.setup import Setup
    from surveysim.studies.sweep.axes import Sweep
    from surveysim.studies.sweep.bands import MultiBandSweep


def refuse_for_sweep(scene: Path, save_timestreams: bool, target_error: str | None, time_budget: str | None) -> None:
    """Raise SceneError for an option that sweeps do not take."""
    reasons = {
        "--save-timestreams": save_timestreams and "which keeps none",
        "--target-error": target_error is not None and "whose points are run whole",
        "--time-budget": time_budget is not None and "whose points are run whole",
    }
    for option, reason in reasons.items():
        if reason:
            fail(f"{scene}: {option}: found a sweep, {reason}; a scene without [sweep] is expected")


def refuse_keep_all(scene: Path, point: int | None, is_sweep: bool) -> None:
    """Raise SceneError for --keep-all without a sweep, or with --point."""
    if not is_sweep:
        fail(f"{scene}: --keep-all: found a scene without [sweep]; a sweep is expected")
    if point is not None:
        fail("--keep-all: found --point, whose run keeps all; one of the two is expected")


def point_setup(scene: Path, sweep: "Sweep | MultiBandSweep | None", number: int) -> "Setup":
    """Prepare the scene of a point; raises SceneError for one that the sweep does not have."""
    from surveysim.reduction.setup import prepare
    from surveysim.studies.sweep.axes import Sweep

    if not isinstance(sweep, Sweep):
        found = "a scene without [sweep]" if sweep is None else "a sweep of several bands"
        fail(f"{scene}: --point: found {found}; a sweep of one band is expected")
    if not 0 <= number < len(sweep.points):
        fail(f"{scene}: --point: found {number}; the number of a point, 0 to {len(sweep.points) - 1}, is expected")
    return prepare(sweep.points[number].scene)
