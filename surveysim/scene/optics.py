"""Section [optics]: telescope aperture, cold stop, and the optical elements from the sky to the detector."""

from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from surveysim.runtime.errors import InputError
from surveysim.scene.fields import Diameter, Length, Line, Load, PhysicalTemperature, ShareOrTable, number
from surveysim.scene.frequency_table import read_frequency_table
from surveysim.scene.section import Section
from surveysim.scene.units import shown

Side = Literal["sky", "detector"]


class OpticalElement(Section):
    """Optical element: a mirror, window, filter, lens or gap of panels.

    It passes `transmission` and emits `emissivity` of a black body at its temperature. With one of the two, the other
    is the rest to 1. With both, the rest to 1 is reflected or scattered, and emits nothing.
    """

    name: Line
    """Name in the tables of the load."""
    temperature_k: PhysicalTemperature = Field(alias="temperature")
    """Physical temperature."""
    side: Side
    """Side of the cold stop: "sky" before it, "detector" behind it."""
    transmission: ShareOrTable = None
    """Transmission: a number, or an ECSV table with the columns `frequency` and `transmission`."""
    emissivity: ShareOrTable = None
    """Emissivity: a number, or an ECSV table with the columns `frequency` and `emissivity`."""

    @cached_property
    def knots(self) -> dict[str, tuple[tuple[float, ...], tuple[float, ...]]]:
        """Frequencies [Hz] and values of `transmission` and `emissivity`, as far as they are given; numbers have one
        knot."""
        found = {}
        for name in ("transmission", "emissivity"):
            value = getattr(self, name)
            if isinstance(value, Path):
                found[name] = read_frequency_table(name, value, name)
            elif value is not None:
                found[name] = ((0.0,), (value,))
        return found

    def losses(self, frequency_hz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute transmission and emissivity (n,) at frequencies (n,) [Hz].

        Raises
        ------
        InputError
            For frequencies outside a table, and where the two exceed 1 together.
        """
        values = {name: _at(name, frequency_hz, *knots) for name, knots in self.knots.items()}
        passed = values["transmission"] if "transmission" in values else 1 - values["emissivity"]
        emitted = values["emissivity"] if "emissivity" in values else 1 - passed
        worst = int(np.argmax(passed + emitted))
        if passed[worst] + emitted[worst] > 1 + 1e-9:
            raise InputError(
                f"found a transmission of {passed[worst]:g} and an emissivity of {emitted[worst]:g}; 1 or less is "
                "expected of their sum"
            )
        return passed, emitted

    @model_validator(mode="after")
    def _one_loss(self) -> Self:
        if self.transmission is None and self.emissivity is None:
            raise ValueError(
                f"{shown(self.name)}: found no 'transmission' and no 'emissivity'; one or both are expected"
            )
        try:
            if all(len(frequency) == 1 for frequency, _ in self.knots.values()):
                self.losses(np.zeros(1))
        except InputError as error:
            raise ValueError(f"{shown(self.name)}: {error}") from None
        return self


def _at(name: str, frequency_hz: np.ndarray, knots: tuple[float, ...], values: tuple[float, ...]) -> np.ndarray:
    if len(knots) == 1:
        return np.full(len(frequency_hz), values[0])
    low, high = frequency_hz.min(), frequency_hz.max()
    if not (knots[0] <= low and high <= knots[-1]):
        raise InputError(
            f"{name}: found a table of {knots[0] / 1e9:g} to {knots[-1] / 1e9:g} GHz; one that covers the passband, "
            f"{low / 1e9:.4g} to {high / 1e9:.4g} GHz, is expected"
        )
    return np.interp(frequency_hz, knots, values)


class OpticalStop(Section):
    """Cold stop: the part of a pixel's beam that does not pass it ends there."""

    temperature_k: PhysicalTemperature = Field(alias="temperature")
    """Physical temperature."""


class Optics(Section):
    """Telescope and optics from the sky to the detector, from which photon noise, beam and flux calibration follow.

    The sky above the first element is that of the site's water in each observation, unless `sky` is given. The last
    factor is `instrument.efficiency`, from the last element to the detector; it emits nothing.
    """

    aperture_m: Length | None = Field(alias="aperture", default=None)
    """Diameter of the illuminated aperture. Required for a beam or a (f/#)lambda that is left out."""
    central_obscuration_m: Diameter = Field(alias="central_obscuration", default=0.0)
    """Diameter of the central obscuration of the aperture."""
    aperture_efficiency: Annotated[float, *number(1e-4, 1)] | None = Field(default=None)
    """Effective area for a point source over the area of the aperture, without what spills: the stop and the elements
    take that. Without it, it follows from the illumination."""
    sky_k: Load | None = Field(
        alias="sky", default=None, json_schema_extra={"otherwise": "CMB, and atmosphere of the site's water"}
    )
    """Load of the sky in Rayleigh-Jeans temperature, CMB included. Temperatures then refer to the sky before the first
    element."""
    stop: OpticalStop | None = None
    """Required where the beams of pixels spill on it: those of horns, and with an edge taper."""
    elements: tuple[OpticalElement, ...] = ()
    """Optical elements, from the sky to the detector."""

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        sides = [element.side for element in self.elements]
        if sides != sorted(sides, reverse=True):
            late = self.elements[max(place for place, side in enumerate(sides) if side == "sky")].name
            raise ValueError(
                f"elements: found {late!r} of side 'sky' after one of side 'detector'; the order from the sky to the "
                "detector is expected"
            )
        given = {"central_obscuration": self.central_obscuration_m, "aperture_efficiency": self.aperture_efficiency}
        for key, value in given.items():
            if value and self.aperture_m is None:
                raise ValueError(f"{key}: found {value:g} without 'aperture', which it refers to")
        if self.aperture_m is not None and self.central_obscuration_m >= self.aperture_m:
            raise ValueError(
                f"central_obscuration: found {self.central_obscuration_m:g} m; less than the aperture, "
                f"{self.aperture_m:g} m, is expected"
            )
        return self
