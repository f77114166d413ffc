"""Figures as points: the same points are drawn and written to tables."""

from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Series:
    """Points of one colour: `x`, `y` (n,), with `low` and `high` (n,) the ends of error bars or of a band.

    Kinds: "line"; "points", with error bars if there are ends; "band" between `low` and `high` (`y` its middle,
    not drawn); "steps", a histogram with `x` the left edges of its bins and the last right edge as one more x, whose y
    is ignored. A NaN breaks a line. `look` is "colour" or "colour dashes", of black, green, blue, vermilion, purple,
    orange, sky and grey, and of "-", "--", ":" and "-.", which as points are discs, squares, triangles and
    diamonds. A series without a label has no entry in the legend. Raises ValueError for arrays of unequal lengths
    and for a band without ends.
    """

    label: str
    kind: Literal["line", "points", "band", "steps"]
    x: np.ndarray
    y: np.ndarray
    look: str
    low: np.ndarray | None = None
    high: np.ndarray | None = None

    def __post_init__(self) -> None:
        shapes = {np.shape(a) for a in (self.x, self.y, self.low, self.high) if a is not None}
        if len(shapes) != 1 or len(min(shapes)) != 1:
            raise ValueError(f"series {self.label!r}: found arrays of shapes {sorted(shapes)}; one length is allowed")
        if (self.low is None) != (self.high is None) or (self.kind == "band" and self.low is None):
            raise ValueError(f"series {self.label!r}: found one end or none; both are expected")


@dataclass(frozen=True)
class Panel:
    """Axes with their series; labels carry units. `square` axes have one scale. `notes` are texts at their (x, y)."""

    title: str
    x_label: str
    y_label: str
    series: tuple[Series, ...]
    x_log: bool = False
    y_log: bool = False
    square: bool = False
    x_range: tuple[float, float] | None = None
    y_range: tuple[float, float] | None = None
    notes: tuple[tuple[float, float, str], ...] = ()


@dataclass(frozen=True)
class PaperFigure:
    """A figure of the paper: its number, panels in rows of `columns`, and a caption that states the simulation."""

    number: int
    title: str
    caption: str
    panels: tuple[Panel, ...]
    columns: int = 1
