"""Random generators keyed by seed, realization, observation, purpose and block.

Leaving a stage out, changing the number of workers, resuming or re-ordering moves no other draw.
"""

from enum import IntEnum
from hashlib import sha256

import numpy as np


class RandomPurpose(IntEnum):
    """Purposes of random numbers that have a number. Numbers are given once and never reused."""

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
    seed: int, purpose: RandomPurpose | str, observation: int = 0, realization: int = 0, block: int = 0
) -> np.random.Generator:
    """Create the generator of one purpose in one observation of one realization.

    Blocks of an observation beyond the first have keys that are longer, and so no other's. A new stream component takes
    its own name as the purpose: its number is a hash of the name.
    """
    number = int.from_bytes(sha256(purpose.encode()).digest()[:8]) if isinstance(purpose, str) else int(purpose)
    key = (realization, observation, number, *((block,) if block else ()))
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=key)))
