"""Observations of a survey that carry the signal simulations."""

import numpy as np

_AT_ONCE = 4  # pairs of observations at the start of a survey
_SPACING = 5  # pairs from one with simulated signal to the next, after those


def carriers(asked: int, observations: int) -> np.ndarray:
    """Choose the observations (n_obs,) bool that carry signal simulations, in pairs of both scan directions.

    The first four pairs, from which even a short survey covers its map, then every fifth pair, up to `asked`
    observations. The rule does not depend on the length of the survey; a short one has fewer than asked.
    """
    chosen, pairs = np.zeros(observations, bool), np.arange(max(1, asked // 2))
    pairs += (_SPACING - 1) * np.maximum(0, pairs - _AT_ONCE + 1)
    carried = (2 * pairs[:, None] + [0, 1]).ravel()
    chosen[carried[carried < observations]] = True
    return chosen
