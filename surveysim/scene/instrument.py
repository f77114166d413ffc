"""The section of the instrument: band, beam, optics, focal plane."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import (
    AngleExtent,
    BandFrequency,
    Bandwidth,
    BeamWidth,
    NoisePsd,
    PositiveAngle,
    Share,
    TableFile,
    Taper,
    number,
    whole,
)
from surveysim.scene.section import Section
from surveysim.scene.units import rj_to_cmb


class Layout(Section):
    """A hexagonal layout around a central position: `rings`, or as many as a round `field_of_view` has room for."""

    rings: Annotated[int, *whole(0, 60)] | None = None
    """Rings around the central position: n rings have 3 n (n + 1) + 1 positions. Or `field_of_view`."""
    field_of_view_rad: PositiveAngle | None = Field(alias="field_of_view", default=None)
    """Diameter of a round area, filled with as many positions as have room in it. Or `rings`."""
    pitch_f_lambda: Annotated[float, *number(0.1, 1000)]
    """Distance of neighbouring positions, in (f/#)lambda."""
    dead: tuple[Annotated[int, *whole(0, 10_980)], ...] = ()
    """Positions without a detector: numbers from 0 at the centre outwards, those equally far by angle."""

    @model_validator(mode="after")
    def _one_extent(self) -> Self:
        if (self.rings is None) == (self.field_of_view_rad is None):
            raise ValueError("exactly one of 'rings' and 'field_of_view' is expected")
        return self


class OtherBand(Section):
    """Another band of every pixel: its place in the spectrum and its noise, all of it white."""

    frequency_hz: BandFrequency = Field(alias="frequency")
    """Centre of the band."""
    bandwidth: Bandwidth
    """Width of the band, as a share of its frequency."""
    psd_mk2_hz: NoisePsd = Field(alias="psd")
    """White noise of a detector, one-sided, in Rayleigh-Jeans temperature."""


class Instrument(Section):
    """Band, beam, optics and focal plane; detectors from `layout` or from the table `positions`.

    Pixels light the stop uniformly, or as horns of the diameter `horn_f_lambda` or with an `edge_taper` do.
    `efficiency` and `polarizations` turn optical power into temperature: they are needed where noise is given by power,
    in `photon.load` and `detector.nep`.
    """

    frequency_hz: BandFrequency = Field(alias="frequency")
    """Centre of the band, which has straight sides."""
    bandwidth: Bandwidth | None = None
    """Width of the band, as a share of its frequency; without it, CMB temperature is that of the band's centre. Needed
    with `atmosphere.site` and where noise is by power."""
    beam_fwhm_rad: BeamWidth = Field(alias="beam_fwhm")
    """Full width at half maximum of the Gaussian beam on the sky."""
    f_lambda_rad: PositiveAngle = Field(alias="f_lambda")
    """One (f/#)lambda on the sky: the wavelength over the diameter of the aperture that is lit."""
    responsivity_scatter: Share
    """Scatter of the detectors' responsivities, relative and log-normal, fixed for the survey."""
    camera_rotation_range_rad: AngleExtent = Field(alias="camera_rotation_range")
    """Full range of the angle by which the camera is turned from one observation to the next."""
    horn_f_lambda: Annotated[float, *number(0.1, 20)] | None = None
    """Diameter of the pixels' horns in (f/#)lambda, no more than the pitch: sets taper and spill on the stop."""
    edge_taper_db: Taper | None = Field(alias="edge_taper", default=None)
    """Gaussian taper with which pixels light the stop, at its edge; 0 dB lights it uniformly. Not beside horns."""
    efficiency: Annotated[float, *number(1e-4, 1)] | None = None
    """Optical efficiency from window to detector, without what horns spill on the stop."""
    polarizations: Annotated[int, *whole(1, 2)] | None = None
    """Polarizations that a detector takes in."""
    layout: Layout | None = None
    """Or `positions`."""
    positions: TableFile = None
    """Detectors in a table beside the scene, columns `x` and `y` with angular units. Or a `layout`."""
    bands: tuple[OtherBand, ...] = ()
    """Any number of them, for "spectral" cleaning, which subtracts them from the band that is mapped."""

    @property
    def cmb_per_rj(self) -> float:
        """Thermodynamic CMB temperature per Rayleigh-Jeans temperature over the band."""
        return rj_to_cmb(self.frequency_hz, self.bandwidth or 0.0)

    @model_validator(mode="after")
    def _one_focal_plane(self) -> Self:
        if (self.layout is None) == (self.positions is None):
            raise ValueError("exactly one of 'layout' (a section) and 'positions' (an ECSV file) is expected")
        if self.horn_f_lambda is not None and self.edge_taper_db is not None:
            raise ValueError("edge_taper: found beside 'horn_f_lambda', which sets it; one of them is expected")
        return self
