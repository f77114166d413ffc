"""Sections of the layers of the atmosphere: height, share of B2, wind, spectrum and evolution of each."""

import math
from typing import Annotated, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import Angle, AngleExtent, Duration, Index, Length, Line, PositiveAngle, Share, number
from surveysim.scene.section import Section

_ROUNDING = 1e-6  # of shares that are written with a few digits


class WindDrift(Section):
    """Slow changes of a layer's wind within an observation, about the wind that is drawn for it.

    They are smooth Gaussian processes, independent in each layer. The wind of a scan is that at its middle.
    """

    speed_rms: Annotated[float, *number(0, 1)] = 0.0
    """Rms of the natural logarithm of the wind speed, which is the fractional change where it is small."""
    direction_rms_rad: AngleExtent = Field(alias="direction_rms", default=0.0)
    """Rms of the change of direction."""
    time_scale_s: Duration = Field(alias="time_scale")
    """Time T of the changes: their correlation at a lag t is exp(-t^2 / 2 T^2)."""

    @model_validator(mode="after")
    def _changes(self) -> Self:
        if self.model_fields_set.isdisjoint({"speed_rms", "direction_rms_rad"}):  # one may be 0, as in a sweep
            raise ValueError("speed_rms: missing; it or 'direction_rms' is expected")
        return self


class Layer(Section):
    """A turbulent layer; together the layers replace the one at `layer_height`.

    The emission is the sum over the layers. Each layer is independent of the others, with its own beam D sin(el) / h.
    """

    name: Line
    """Name in plans and reports."""
    height_m: Length = Field(alias="height")
    """Height above the telescope, no less than the illuminated aperture."""
    share: Share
    """The layer's fraction of B2; all sum to 1. B2 is in angles on the sky, whatever the height."""
    wind_factor: Annotated[float, *number(0, 100)] = 1.0
    """Wind speed in m/s over that of the drawn wind, which is the drawn angular speed times `layer_height`. With 1 the
    angular speed is proportional to 1 / `height`."""
    wind_turn_rad: Angle = Field(alias="wind_turn", default=0.0)
    """Direction of the wind relative to that of the drawn wind."""
    outer_scale_m: Length | None = Field(
        alias="outer_scale", default=None, json_schema_extra={"otherwise": "that of [atmosphere]"}
    )
    """Outer scale of the layer's turbulence."""
    spectral_index: Index | None = Field(default=None, json_schema_extra={"otherwise": "that of [atmosphere]"})
    """Spectral index of the layer. Another index than that of [atmosphere] requires `pivot`."""
    pivot_rad: PositiveAngle | None = Field(alias="pivot", default=None)
    """Wavelength on the sky at which a layer with an index of its own has the power spectrum of a layer with the
    index of [atmosphere] and the same `share`."""
    decorrelation_time_s: Duration | None = Field(
        alias="decorrelation_time", default=None, json_schema_extra={"otherwise": "that of [atmosphere]"}
    )
    """Time in which the layer's pattern evolves."""
    wind_drift: WindDrift | None = None
    """Changes of the layer's wind, in place of those of [atmosphere]."""


def check_layers(layers: tuple[Layer, ...], index: float, outer_scale_m: float | None, aperture_m: float) -> None:
    """Raise ValueError for layers that are no division of B2, or that the aperture or the spectrum does not allow."""
    total, names = math.fsum(layer.share for layer in layers), [layer.name for layer in layers]
    if not abs(total - 1) <= _ROUNDING:
        raise ValueError(f"layers: found shares that sum to {total:.7g}; 1 is expected")
    for place, layer in enumerate(layers):
        where = f"layers.{place}"
        if layer.name in names[:place]:
            raise ValueError(f"{where}.name: found {layer.name!r} twice; different names are expected")
        if layer.height_m < aperture_m:
            raise ValueError(
                f"{where}.height: found {layer.height_m:g} m with an aperture of {aperture_m:g} m; no less than the"
                " aperture is expected, as the layer is seen through D / h radian"
            )
        if layer.outer_scale_m is not None and layer.outer_scale_m < aperture_m:
            raise ValueError(
                f"{where}.outer_scale: found {layer.outer_scale_m:g} m with an aperture of {aperture_m:g} m; no less"
                " than the aperture is expected"
            )
        _check_spectrum(where, layer, index, outer_scale_m)


def _check_spectrum(where: str, layer: Layer, index: float, outer_scale_m: float | None) -> None:
    own = index if layer.spectral_index is None else layer.spectral_index
    if (own != index) != (layer.pivot_rad is not None):
        found = "found without a 'spectral_index' of its own" if own == index else "missing"
        raise ValueError(f"{where}.pivot: {found}; a layer with another index than {index:g}, and no other, needs it")
    if own >= 4 and layer.outer_scale_m is None and outer_scale_m is None:
        raise ValueError(f"{where}.outer_scale: missing; an index of {own:g} (4 or more) needs an outer scale")
