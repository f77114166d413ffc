"""Random generators keyed by what they are for: (seed, realization, observation, stage), and by the block of it.

Leaving a stage out, changing the number of workers, resuming or re-ordering moves no other draw.
"""

from enum import IntEnum

import numpy as np


class RandomPurpose(IntEnum):
    """What a stream of random numbers is for. Numbers are given once and never reused."""

    WEATHER = 0
    POINTING = 1
    RESPONSIVITY = 2
    ATMOSPHERE = 3
    EXCESS = 4
    PHOTON = 5
    DETECTOR = 6
    SKY = 7
    UNCORRELATED = 8
    WHITE = 9
    WINDOW_SKY = 10
    JACKKNIFE = 11
    TREND = 12
    CALIBRATION = 13


def generator(
    seed: int, stage: RandomPurpose, observation: int = 0, realization: int = 0, block: int = 0
) -> np.random.Generator:
    """The generator of one stage of one observation of one realization.

    Blocks of an observation beyond the first have keys that are longer, and so no other's.
    """
    key = (realization, observation, int(stage), *((block,) if block else ()))
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=key)))
