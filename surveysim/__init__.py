"""Monte Carlo survey simulator for millimetre-wave cameras that look through a turbulent atmosphere."""

from importlib import import_module
from typing import Any

__version__ = "0.4.0"

_PUBLIC = {
    "load_scene": "surveysim.scene.scene",
    "SceneError": "surveysim.runtime.errors",
    "simulate_observation": "surveysim.api",
    "run": "surveysim.api",
    "Engine": "surveysim.runtime.engine",
    "EngineError": "surveysim.runtime.engine",
    "load_sweep": "surveysim.studies.sweep.axes",
    "run_sweep": "surveysim.api",
}
__all__ = ["__version__", *_PUBLIC]


def __getattr__(name: str) -> Any:
    # Loaded on first use: `import surveysim` alone should cost nothing.
    if name in _PUBLIC:
        return getattr(import_module(_PUBLIC[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
