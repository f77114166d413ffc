"""Metric `largest_scale`: multipole at which scans and cleaning leave half of the signal's power."""

import numpy as np

from surveysim.metrics.map_noise import MapNoise, Quantity
from surveysim.scene.metrics import LargestScale

SHARE = 0.5


def quantities(noise: MapNoise, options: LargestScale) -> tuple[Quantity, ...]:
    """Find the multipole above which the transfer function stays above one half.

    Between the mean multipoles of the bins it is linear in ln ell. A crossing outside the bins has no value, and the
    note says on which side it lies.
    """
    ell, passed = noise.map.ell, noise.transmission
    below = np.flatnonzero(passed < SHARE)
    if not len(below):
        return (Quantity("ell", np.nan, "", note=f"below the lowest bin, ell = {ell[0]:.0f}"),)
    last = int(below[-1])
    if last == len(ell) - 1:
        return (Quantity("ell", np.nan, "", note=f"above the highest bin, ell = {ell[-1]:.0f}"),)
    share = (SHARE - passed[last]) / (passed[last + 1] - passed[last])
    low, high = np.log(np.maximum(ell[last : last + 2], 1e-9))
    return (Quantity("ell", float(np.exp(low + share * (high - low))), ""),)
