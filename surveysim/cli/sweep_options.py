"""Options of `run` that sweeps take or refuse, and the point that --point selects."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from surveysim.cli.options import fail
from surveysim.runtime.errors import InputError

if TYPE_CHECKING:
    from surveysim.reduction.setup import Setup
    from surveysim.studies.sweep.axes import Sweep
    from surveysim.studies.sweep.bands import MultiBandSweep
    from surveysim.studies.sweep.rounds import SweepLimits


def refuse_for_sweep(scene: Path, save_timestreams: bool, time_budget: str | None) -> None:
    """Raise SceneError for an option that sweeps do not take."""
    reasons = {
        "--save-timestreams": save_timestreams and "which keeps none",
        "--time-budget": time_budget is not None and "whose points run to the end of a round",
    }
    for option, reason in reasons.items():
        if reason:
            fail(f"{scene}: {option}: found a sweep, {reason}; a scene without [sweep] is expected")


def sweep_limits(target_error: str | None, confidence: str | None) -> "SweepLimits | None":
    """Parse the criteria that end a sweep early; None without a target error."""
    from surveysim.scene.units import to_float
    from surveysim.studies.sweep.rounds import CONFIDENCE, SweepLimits

    if target_error is None:
        if confidence is not None:
            fail("--confidence: found no --target-error; both are expected")
        return None
    values = []
    for name, text in (("--target-error", target_error), ("--confidence", confidence)):
        try:
            values.append(CONFIDENCE if text is None else to_float(text, ""))
        except InputError as error:
            fail(f"{name}: {error}")
    try:
        return SweepLimits(*values)
    except InputError as error:
        fail(str(error))


def sweep_limits_settings(limits: "SweepLimits | None") -> dict[str, Any]:
    """Return the limits of a sweep that differ from their defaults, for the name of its directory."""
    from surveysim.studies.sweep.rounds import CONFIDENCE

    if limits is None:
        return {}
    own = {} if limits.confidence == CONFIDENCE else {"confidence": limits.confidence}
    return {"target_error": limits.target_error, **own}


def sweep_work(sweep: "Sweep", in_rounds: bool) -> tuple[list[float], str]:
    """Return the work of each point, or of each point in each round, and the word for these items."""
    from surveysim.studies.sweep.rounds import round_ends

    if not in_rounds:
        return [point.detector_samples for point in sweep.points], "points"
    ends = round_ends(sweep.points)
    parts = [(end - begin) / ends[-1] for begin, end in zip((0, *ends), ends, strict=False)]
    return [part * point.detector_samples for part in parts for point in sweep.points], "rounds of points, at most"


def refuse_keep_all(scene: Path, point: int | None, is_sweep: bool) -> None:
    """Raise SceneError for --keep-all without a sweep, or with --point."""
    if not is_sweep:
        fail(f"{scene}: --keep-all: found a scene without [sweep]; a sweep is expected")
    if point is not None:
        fail("--keep-all: found --point, whose run keeps all; one of the two is expected")


def refuse_reference(reference: str | None, point: int | None) -> None:
    """Raise SceneError for --reference with --point."""
    if reference is not None and point is not None:
        fail("--reference: found --point, whose run has no ratios; one of the two is expected")


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
