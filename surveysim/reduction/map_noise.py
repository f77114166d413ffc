"""Noise of the map of one observation."""

import numpy as np

from surveysim.reduction.scored_region import ScoredRegion


def map_noise(region: ScoredRegion | None, total: np.ndarray, hits: np.ndarray) -> tuple[float, np.ndarray]:
    """Measure the noise variance per sample of the map of one observation.

    With a score it is measured in the scored multipoles, with the weights of a flat band power:
    ``sum M^2 |FT(T S)|^2 / (sum M^2 sum T^2 H)`` for sums S and hits H under the taper T. For white noise it is the
    variance of a sample. It includes correlations between detectors, which the PSD of a time-stream does not. Without a
    score it is the mean of ``S^2 / H`` over hit pixels.

    Returns
    -------
    noise : float [mK^2]
        Infinite without a hit.
    bin_noise : (n_bin,) array [mK^2]
        The same in each multipole bin; empty without a score.
    """
    if region is None:
        hit = hits > 0
        return float(np.mean(total[hit].astype(float) ** 2 / hits[hit])) if hit.any() else np.inf, np.zeros(0)
    rows = region.patch
    return region.noise(total[rows, rows], hits[rows, rows])
