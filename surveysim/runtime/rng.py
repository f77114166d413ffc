"""Random generators keyed by seed, realization, observation, purpose and block.

Draws of one purpose do not depend on other stages, on the number of workers, or on the order of observations.
"""

from enum import IntEnum
from hashlib import sha256

import numpy as np


class RandomPurpose(IntEnum):
    """Purposes of random numbers that have a number. A number is part of the key and never reused."""

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
    SIGNAL_SIM = 10
    JACKKNIFE = 11
    TREND = 12
    CALIBRATION = 13


def generator(
    seed: int, purpose: RandomPurpose | str, observation: int = 0, *, realization: int = 0, block: int = 0
) -> np.random.Generator:
    """Make the random generator of one purpose in one observation and realization.

    Parameters
    ----------
    seed
        Seed of the scene.
    purpose
        Purpose of the random numbers. A new stream component takes its own name, whose hash is its number.
    observation, realization, block
        Indices from 0. Block 0 is not part of the key.
    """
    number = int.from_bytes(sha256(purpose.encode()).digest()[:8]) if isinstance(purpose, str) else int(purpose)
    key = (realization, observation, number, *((block,) if block else ()))
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence(seed, spawn_key=key)))
