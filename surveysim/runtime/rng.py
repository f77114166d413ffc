"""Random numbers keyed by seed, realization, observation, purpose, block and band.

Draws of one purpose do not depend on other stages (photon and detector noise are one), on the number of workers, or on
the order of observations. Noise is made of `NormalDeviates`, at a tenth of the cost of numpy's. Scalars come from a
generator of numpy.
"""

from dataclasses import dataclass
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
    WEATHER_DRIFT = 14
    EVOLUTION = 15
    WIND_DRIFT = 16


@dataclass(frozen=True)
class NormalDeviates:
    """A sequence of independent standard normal deviates; any part of it can be drawn alone.

    Deviates are exact to the rounding errors of their type, and reach 7.5 standard deviations (10 in float64). Both
    types have the same deviates, within 1e-6. All machines draw the same bits.

    Parameters
    ----------
    words
        Four 32-bit numbers that tell one sequence from another.
    """

    words: tuple[int, ...]

    def draw(self, shape: int | tuple[int, ...], *, first: int = 0, dtype: type | np.dtype = np.float32) -> np.ndarray:
        """Draw an array of the deviates from position `first` on, float32 or float64."""
        out = np.empty(shape, dtype)
        self.fill(out, first)
        return out

    def fill(self, out: np.ndarray, first: int = 0) -> None:
        """Fill a contiguous float32 or float64 array with the deviates from position `first` on."""
        from surveysim.runtime.normal_kernels import fill_float32, fill_float64

        fill = fill_float32 if _is_single(out) else fill_float64
        fill(out.reshape(-1), first, np.array(self.words, np.uint32))

    def add(self, out: np.ndarray, scale: float, first: int = 0) -> None:
        """Add the deviates from position `first` on, times a scale, to a contiguous float32 or float64 array."""
        from surveysim.runtime.normal_kernels import add_float32, add_float64

        add = add_float32 if _is_single(out) else add_float64
        add(out.reshape(-1), out.dtype.type(scale), first, np.array(self.words, np.uint32))


def _is_single(out: np.ndarray) -> bool:
    """Return whether a contiguous array is float32; raises ValueError unless it is float32 or float64."""
    if not out.flags.c_contiguous or out.dtype not in (np.float32, np.float64):
        raise ValueError(f"found {out.dtype} of strides {out.strides}; contiguous float32 or float64 is expected")
    return bool(out.dtype == np.float32)


def normal_deviates(
    seed: int,
    purpose: RandomPurpose | str,
    observation: int = 0,
    *,
    realization: int = 0,
    block: int = 0,
    band: str = "",
    part: str = "",
) -> NormalDeviates:
    """Make the normal deviates of one purpose; parameters as for `generator`."""
    words = _seed_sequence(seed, purpose, observation, (realization, block), band, part).generate_state(4)
    return NormalDeviates(tuple(words.tolist()))


def generator(
    seed: int,
    purpose: RandomPurpose | str,
    observation: int = 0,
    *,
    realization: int = 0,
    block: int = 0,
    band: str = "",
    part: str = "",
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
    band
        Name of the band of a camera, for numbers that bands do not share. An empty name is not part of the key.
    part
        Name of one of several things that share a purpose, such as a layer of the air. An empty name is not part of
        the key.
    """
    sequence = _seed_sequence(seed, purpose, observation, (realization, block), band, part)
    return np.random.Generator(np.random.SFC64(sequence))


def _seed_sequence(
    seed: int, purpose: RandomPurpose | str, observation: int, realization_block: tuple[int, int], band: str, part: str
) -> np.random.SeedSequence:
    realization, block = realization_block
    number = _number(purpose) if isinstance(purpose, str) else int(purpose)
    own = (
        *((block,) if block else ()),
        *((_number(band),) if band else ()),
        *((_number(f"part {part}"),) if part else ()),
    )
    return np.random.SeedSequence(seed, spawn_key=(realization, observation, number, *own))


def _number(name: str) -> int:
    return int.from_bytes(sha256(name.encode()).digest()[:8])
