"""Section [numerics]: numerical settings, a trade of accuracy against computing time."""

from typing import Annotated, Literal

from pydantic import Field

from surveysim.scene.fields import Memory, number
from surveysim.scene.section import Section


class Numerics(Section):
    """Numerical settings without physical meaning; `surveysim accuracy` measures their effect."""

    precision: Literal["float32", "float64"] = "float32"
    """Precision of time-streams, screens and maps; random numbers have 24 bits in either."""
    interpolation: Literal["nearest", "linear", "cubic"] = "linear"
    """Interpolation between lattice points of the screen."""
    screen_step: Annotated[float, *number(0.1, 10)] = 1.0
    """Lattice step of the screen, relative to the step chosen from the beam and the focal plane."""
    max_block_bytes: Memory = Field(alias="max_block_memory", default=250e6)
    """Largest size of the time-streams of a block, in single precision. Larger observations are simulated in blocks of
    whole scans, each with its own random numbers; a larger scan is a block by itself. The peak memory of a process is
    up to ten times as large."""
