"""The section of the instrument: band, beam, optics, focal plane."""

from typing import Self

from pydantic import Field, model_validator

from surveysim.quantities import (
    AngleExtent,
    BeamWidth,
    Frequency,
    NoisePsd,
    Positive,
    PositiveAngle,
    TableFile,
    Taper,
)
from surveysim.sections.base import Section


class Layout(Section):
    """A hexagonal layout around a central position: rings, or as many as a round field of view has room for.

    `pitch_f_lambda` is the distance of neighbours in (f/#)lambda; `dead` lists positions without a detector.
    """

    rings: int | None = Field(ge=0, le=60, default=None)
    field_of_view_rad: PositiveAngle | None = Field(alias="field_of_view", default=None)
    pitch_f_lambda: Positive
    dead: tuple[int, ...] = ()

    @model_validator(mode="after")
    def _one_extent(self) -> Self:
        if (self.rings is None) == (self.field_of_view_rad is None):
            raise ValueError("exactly one of 'rings' and 'field_of_view' is expected")
        return self


class Colour(Section):
    """Another band of every pixel: its place in the spectrum and its noise, all of it white."""

    frequency_hz: Frequency = Field(alias="frequency", le=1e13)
    bandwidth: float = Field(gt=0, lt=1)
    psd_mk2_hz: NoisePsd = Field(alias="psd")


class Instrument(Section):
    """Band, beam, optics and focal plane; detectors from `layout` or from the table `positions`.

    Pixels light the stop uniformly, or as horns of the diameter `horn_f_lambda` or with an `edge_taper` do.
    `efficiency`, from window to detector and with horns without what they spill on the stop, and `polarizations` turn
    optical power into temperature, where noise is given by power. `colours` are further bands of the same pixels,
    which "spectral" cleaning subtracts from the one that is mapped.
    """

    frequency_hz: Frequency = Field(alias="frequency", le=1e13)
    bandwidth: float | None = Field(gt=0, lt=1, default=None)
    beam_fwhm_rad: BeamWidth = Field(alias="beam_fwhm")
    f_lambda_rad: PositiveAngle = Field(alias="f_lambda")
    responsivity_scatter: float = Field(ge=0, le=1)
    camera_rotation_rad: AngleExtent = Field(alias="camera_rotation")
    horn_f_lambda: float | None = Field(ge=0.1, le=20, default=None)
    edge_taper_db: Taper | None = Field(alias="edge_taper", default=None)
    efficiency: float | None = Field(ge=1e-4, le=1, default=None)
    polarizations: int | None = Field(ge=1, le=2, default=None)
    layout: Layout | None = None
    positions: TableFile = None
    colours: tuple[Colour, ...] = ()

    @model_validator(mode="after")
    def _one_focal_plane(self) -> Self:
        if (self.layout is None) == (self.positions is None):
            raise ValueError("exactly one of 'layout' (a section) and 'positions' (an ECSV file) is expected")
        if self.horn_f_lambda is not None and self.edge_taper_db is not None:
            raise ValueError("edge_taper: found beside 'horn_f_lambda', which sets it; one of them is expected")
        return self
