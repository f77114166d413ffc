"""Sections [instrument.layout] and [[instrument.wafers]]: detectors on lattices."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import Angle, PositiveAngle, number, quantity, whole
from surveysim.scene.section import Section

FarAngle = Annotated[float, *quantity("rad", "arcmin", at_least="-15 deg", at_most="15 deg")]


class Lattice(Section):
    """Keys that a layout and a wafer have in common."""

    shape: Literal["hexagon", "square", "rhombus"] = "hexagon"
    """Outline, and lattice in it: "hexagon" and "rhombus" are hexagonal lattices, the latter with angles of 60 and 120
    degrees; "square" is a square lattice."""
    rings: Annotated[int, *whole(0, 60)] | None = None
    """Number of rings around the central position: n rings have 3 n (n + 1) + 1 positions. Required with shape
    "hexagon" without `field_of_view`."""
    field_of_view_rad: PositiveAngle | None = Field(alias="field_of_view", default=None)
    """Diameter of a round area filled with detectors on a hexagonal lattice. Alternative: `rings`."""
    side: Annotated[int, *whole(1, 120)] | None = None
    """Number of detectors along a side: n have n squared positions. Required with shape "square" or "rhombus"."""
    pitch_f_lambda: Annotated[float, *number(0.1, 1000)]
    """Distance between neighbouring detectors, in (f/#)lambda."""
    dead: tuple[Annotated[int, *whole(0, 14_399)], ...] = ()
    """Positions without a working detector, counted from 0 at the centre outwards, at equal distance by angle."""
    yield_fraction: Annotated[float, *number(0.001, 1)] = Field(alias="yield", default=1.0)
    """Fraction of the positions, those in `dead` aside, that have a working detector. The others are chosen at random,
    by the seed."""

    @model_validator(mode="after")
    def _one_extent(self) -> Self:
        if self.shape == "hexagon":
            if self.side is not None:
                raise ValueError("side: found with shape 'hexagon'; 'rings' or 'field_of_view' is expected")
            if (self.rings is None) == (self.field_of_view_rad is None):
                raise ValueError("exactly one of 'rings' and 'field_of_view' is expected")
            return self
        for name, value in (("rings", self.rings), ("field_of_view", self.field_of_view_rad)):
            if value is not None:
                raise ValueError(f"{name}: found with shape {self.shape!r}; 'side' is expected")
        if self.side is None:
            raise ValueError(f"side: missing; shape {self.shape!r} needs the number of detectors along a side")
        return self


class Layout(Lattice):
    """Detectors on one lattice, centred on the boresight: a hexagon of rings, a round field of view, a square or a
    rhombus."""


class Wafer(Lattice):
    """One wafer of several: a layout, rotated about its centre and moved off the boresight."""

    offset_x_rad: FarAngle = Field(alias="offset_x", default=0.0)
    """Offset of the wafer's centre from the boresight along the x axis of the array."""
    offset_y_rad: FarAngle = Field(alias="offset_y", default=0.0)
    """Offset along the y axis."""
    rotation_rad: Angle = Field(alias="rotation", default=0.0)
    """Rotation of the wafer about its centre, from the x axis towards the y axis."""
