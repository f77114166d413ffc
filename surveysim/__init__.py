"""Monte Carlo survey simulator for millimetre-wave cameras that look through a turbulent atmosphere."""

from importlib import import_module
from typing import Any

__version__ = "0.10.0"

_PUBLIC = {
    "load_scene": "surveysim.scene.scene",
    "load_bands": "surveysim.scene.bands",
    "simulate_observation": "surveysim.api",
    "run": "surveysim.api",
    "forecast": "surveysim.api",
    "plan": "surveysim.api",
    "compare": "surveysim.api",
    "load_sweep": "surveysim.studies.sweep.axes",
    "load_band_sweep": "surveysim.studies.sweep.bands",
    "run_sweep": "surveysim.api",
    "forecast_sweep": "surveysim.api",
    "plan_sweep": "surveysim.api",
    "budget": "surveysim.api",
    "load_problem": "surveysim.studies.optimise.problem",
    "optimise": "surveysim.api",
    "track": "surveysim.api",
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
