"""The section of numerical choices: they trade accuracy for time and say nothing about telescope or sky."""

from typing import Annotated, Literal

from pydantic import Field

from surveysim.scene.fields import Memory, number
from surveysim.scene.section import Section


class Numerics(Section):
    """How streams are computed: numerical choices, not physical ones; "surveysim accuracy" measures what they cost."""

    precision: Literal["float32", "float64"] = "float32"
    """Of streams, strips of the layer and maps; random numbers have 24 bits in both."""
    interpolation: Literal["nearest", "linear", "cubic"] = "linear"
    """Of look-ups between the layer's lattice points."""
    screen_step: Annotated[float, *number(0.1, 10)] = 1.0
    """Lattice step of the layer, over the one that is chosen for the beam and the camera."""
    max_block_bytes: Memory = Field(alias="max_block_memory", default=250e6)
    """The most that the streams of a block take, counted in single precision: larger observations are made in blocks
    of whole scans, each with random numbers of its own. A process holds up to ten times as much at its peak. Larger
    blocks are no faster; the default has room for scans of 6000 samples of 10,000 detectors."""
