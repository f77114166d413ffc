"""Metric `time_to`: observing time after which another metric reaches a value.

The noise PSD of a survey goes as one over its time; weather, coverage and transfer function stay. The time solves
``q(N hours / t) = value`` for the other metric's quantity q.
"""

from collections.abc import Callable

import numpy as np

from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.scene.metrics import TimeTo

_MOST = 1e12  # factor of the survey's time; beyond it the value is out of reach


def quantities(noise: MapNoise, options: TimeTo, target: Callable[[MapNoise], Quantity]) -> tuple[Quantity, ...]:
    """Compute the hours of scans and turnarounds after which `target` reaches `options.value`.

    Infinite, with a note, where no time is enough, and 0 where the value does not depend on time and is reached.
    """
    now = target(noise)
    if not 0 < now.value < np.inf:
        return (Quantity("hours", np.nan, "h", note=f"{options.of} has no value{f': {now.note}' * bool(now.note)}"),)
    sign = 1 if now.lower_is_better else -1

    def missing(log_time: float) -> float:
        """Logarithm of the value over the target; positive where it is not reached."""
        return sign * float(np.log(target(noise.scaled(np.exp(-log_time))).value / options.value))

    latest = np.log(_MOST)
    if missing(latest) > 0:
        return (Quantity("hours", np.inf, "h", note=f"never: {options.of} stays {_side(sign)} {options.value:g}"),)
    if missing(-latest) <= 0:
        return (Quantity("hours", 0.0, "h", note=f"{options.of} is reached at any time"),)
    from scipy.optimize import brentq

    return (Quantity("hours", float(noise.map.hours * np.exp(brentq(missing, -latest, latest, xtol=1e-12))), "h"),)


def _side(sign: int) -> str:
    return "above" if sign > 0 else "below"
