"""Random deviates alone, and surveysim."""

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from peer_codes.observation import Observation, Streams


def numpy_deviates(seen: Observation) -> Callable[[], Any]:
    """Draw a float32 deviate a detector-sample with numpy's SFC64."""
    rng, out = np.random.Generator(np.random.SFC64(1)), np.empty(seen.shape, np.float32)
    return lambda: rng.standard_normal(out=out, dtype=np.float32)


def surveysim(seen: Observation) -> Callable[[], Observation]:
    """Simulate an observation as in a survey, with the PSDs of its streams."""
    from surveysim.reduction.observation import observe

    numbers = itertools.count()

    def run() -> Observation:
        observe(seen.setup, next(numbers), False)
        return seen

    return run


def surveysim_streams(seen: Observation) -> Streams:
    """Draw and clean the streams of the first observation."""
    from mapmaker.cleaning import TemplateOptions, clean
    from surveysim.timestreams.observation import draw_observation

    drawn = draw_observation(seen.setup, 0)
    options = TemplateOptions(tolerance=1e-8, max_iterations=100)
    cleaned = clean("average", drawn.data_mk, drawn.scan_bounds, drawn.focal_plane, options=options)
    return drawn.data_mk, cleaned.data_mk
