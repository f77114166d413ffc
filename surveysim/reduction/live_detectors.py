"""Cleaning pipelines for the detectors that have data in a block."""

from dataclasses import replace

import numpy as np

from surveysim.reduction.cleaning_pipelines import CleaningPipeline, needed_detectors
from surveysim.reduction.setup import Setup


def live_pipelines(setup: Setup, live: np.ndarray) -> tuple[CleaningPipeline, ...]:
    """Pipelines for the detectors that have samples, (n_det,) bool.

    A pipeline keeps all its detectors where fewer than it needs have samples: gaps of the others are filled.
    """
    if live.all():
        return setup.analysis.pipelines
    return tuple(_with_live(setup, pipeline, live) for pipeline in setup.analysis.pipelines)


def _with_live(setup: Setup, pipeline: CleaningPipeline, live: np.ndarray) -> CleaningPipeline:
    rows = np.arange(len(live))[pipeline.rows]
    needed = max(needed_detectors(setup.scene.cleaning, name) for name in pipeline.steps)
    return replace(pipeline, detectors=rows[live[rows]]) if live[rows].sum() >= needed else pipeline
