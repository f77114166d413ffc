"""The Python interface of plans: predicted costs of runs and sweeps, of one band or of several."""

from pathlib import Path

from surveysim.api.bands import checked_bands
from surveysim.api.surveys import scene_as_given
from surveysim.api.sweeps import sweep_as_given
from surveysim.reduction.setup import prepare
from surveysim.runtime.engine import default_workers
from surveysim.scene.bands import MultiBandScene
from surveysim.scene.scene import Scene
from surveysim.studies.resources import Plan, make_plan
from surveysim.studies.sweep.axes import Sweep
from surveysim.studies.sweep.bands import MultiBandSweep, load_band_sweep
from surveysim.studies.sweep.plan import SweepPlan, make_sweep_plan


def plan_survey(scene: Scene | str | Path, workers: int | None = None, *, start_s: float = 0.0) -> Plan:
    """Predict the cost of a run of one band; parameters and errors are those of `surveysim.plan`."""
    return make_plan(prepare(scene_as_given(scene)), workers or default_workers(), start_s)


def plan_bands(
    scenes: MultiBandScene | str | Path, workers: int | None = None, *, start_s: float = 0.0
) -> dict[str, Plan]:
    """Predict the cost of a run of each band, by name; parameters and errors are those of `surveysim.plan`."""
    scenes = checked_bands(scenes)
    return {name: plan_survey(scene, workers, start_s=start_s) for name, scene in scenes.bands.items()}


def plan_single_sweep(sweep: Sweep | str | Path, workers: int | None = None, *, start_s: float = 0.0) -> SweepPlan:
    """Predict the cost of a sweep of one band; parameters and errors are those of `surveysim.plan_sweep`."""
    return make_sweep_plan(sweep_as_given(sweep), workers or default_workers(), start_s)


def plan_band_sweep(
    sweep: MultiBandSweep | str | Path, workers: int | None = None, *, start_s: float = 0.0
) -> dict[str, SweepPlan]:
    """Predict the cost of the sweep of each band, by name; parameters are those of `surveysim.plan_sweep`."""
    sweep = sweep if isinstance(sweep, MultiBandSweep) else load_band_sweep(sweep)
    return {name: plan_single_sweep(item, workers, start_s=start_s) for name, item in sweep.bands.items()}
