"""Monte Carlo survey simulator for millimetre-wave cameras that look through a turbulent atmosphere."""

from importlib import import_module
from typing import Any

__version__ = "0.11.0"

_PUBLIC = {
    "load_scene": "surveysim.scene.scene",
    "load_bands": "surveysim.scene.bands",
    "simulate_observation": "surveysim.api.surveys",
    "run": "surveysim.api.public",
    "forecast": "surveysim.api.public",
    "plan": "surveysim.api.public",
    "compare": "surveysim.api.comparisons",
    "load_sweep": "surveysim.studies.sweep.axes",
    "load_band_sweep": "surveysim.studies.sweep.bands",
    "run_sweep": "surveysim.api.public",
    "forecast_sweep": "surveysim.api.public",
    "plan_sweep": "surveysim.api.public",
    "budget": "surveysim.api.budgets",
    "load_problem": "surveysim.studies.optimise.problem",
    "optimise": "surveysim.api.optimum",
    "track": "surveysim.api.tracks",
    "scene_names": "surveysim.scene.shipped",
    "Engine": "surveysim.runtime.engine",
    "InputError": "surveysim.runtime.errors",
    "SceneError": "surveysim.runtime.errors",
    "NotForecastableError": "surveysim.runtime.errors",
    "OutputError": "surveysim.output.lock",
    "FinishedError": "surveysim.output.directory",
    "CheckpointError": "surveysim.survey.checkpoint",
    "EngineError": "surveysim.runtime.engine",
}
__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    # Loaded on first use: `import surveysim` alone should cost nothing.
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
