"""The section of the instrument: band, beam, optics, focal plane."""

from typing import Self

from pydantic import Field, model_validator

from surveysim.quantities import AngleExtent, BeamWidth, Frequency, NoisePsd, Positive, PositiveAngle, TableFile
from surveysim.sections.base import Section


class Layout(Section):
    """A hexagonal layout: rings around a central position, pitch in (f/#)lambda, dead positions."""

    rings: int = Field(ge=0, le=60)
    pitch_f_lambda: Positive
    dead: tuple[int, ...] = ()


class Colour(Section):
    """Another band of every pixel: its place in the spectrum and its noise, all of it white."""

    frequency_hz: Frequency = Field(alias="frequency", le=1e13)
    bandwidth: float = Field(gt=0, lt=1)
    psd_mk2_hz: NoisePsd = Field(alias="psd")


class Instrument(Section):
    """Band, beam and focal plane; detectors from `layout` or from the table `positions`.

    `colours` are further bands of the same pixels, which "spectral" cleaning subtracts from the one that is mapped.
    """

    frequency_hz: Frequency = Field(alias="frequency", le=1e13)
    bandwidth: float | None = Field(gt=0, lt=1, default=None)
    beam_fwhm_rad: BeamWidth = Field(alias="beam_fwhm")
    f_lambda_rad: PositiveAngle = Field(alias="f_lambda")
    responsivity_scatter: float = Field(ge=0, le=1)
    camera_rotation_rad: AngleExtent = Field(alias="camera_rotation")
    layout: Layout | None = None
    positions: TableFile = None
    colours: tuple[Colour, ...] = ()

    @model_validator(mode="after")
    def _one_focal_plane(self) -> Self:
        if (self.layout is None) == (self.positions is None):
            raise ValueError("exactly one of 'layout' (a section) and 'positions' (an ECSV file) is expected")
        return self
