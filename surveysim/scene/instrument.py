"""Section [instrument]: band, beam, optics and focal plane."""

from functools import cached_property
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, JsonValue, model_validator

from surveysim.runtime.errors import InputError
from surveysim.scene.detector_table import DetectorTable, detector_table
from surveysim.scene.fields import (
    AngleExtent,
    BandFrequency,
    Bandwidth,
    BeamWidth,
    Line,
    PositiveAngle,
    Share,
    TableFile,
    TableOrName,
    Taper,
    number,
    whole,
)
from surveysim.scene.illumination_table import IlluminationTable, read_illumination
from surveysim.scene.layout import Layout, Wafer
from surveysim.scene.passband import Passband, read_passband, top_hat
from surveysim.scene.section import Section
from surveysim.scene.units import shown

_FROM_APERTURE: dict[str, JsonValue] = {"otherwise": "that of `optics.aperture`"}


# Illuminations, and the keys that one of them needs.
_BEAM_KEYS: dict[str, tuple[str, ...]] = {
    "uniform": (),
    "gaussian": ("horn_f_lambda", "edge_taper"),
    "he11": ("horn_f_lambda",),
}


class Instrument(Section):
    """Band, beam, optics and focal plane; detectors from `layout`, from `wafers` or from the table `positions`.

    Pixels illuminate the stop uniformly, unless `illumination`, `horn_f_lambda` or `edge_taper` is given. The part of
    their beam beyond the edge of the stop is spillover. `efficiency` and `polarizations` convert optical power to
    temperature. They are required where noise is given by power, in `photon.load` and `detector.nep`.
    """

    frequency_hz: BandFrequency | None = Field(alias="frequency", default=None)
    """Centre frequency of the band, a top hat. Alternative: `passband`."""
    bandwidth: Bandwidth | None = None
    """Width of the band as a fraction of its centre frequency. Without it, CMB temperatures are converted at the centre
    frequency. Required with `atmosphere.site` and where noise is given by power."""
    passband: TableOrName = None
    """Transmission of the band: an ECSV table with the columns `frequency` and `transmission` (its scale does not
    matter, efficiency is `efficiency`), path relative to the scene file, or the name of a band that ships, such as
    `alma_band_6`. Alternative: `frequency` and `bandwidth`."""
    # Angles that are left out are None until the scene is prepared.
    beam_fwhm_rad: BeamWidth = Field(alias="beam_fwhm", default=None, json_schema_extra=_FROM_APERTURE)
    """Full width at half maximum (FWHM) of the Gaussian beam on the sky. Without it, that of the diffraction by
    `optics.aperture`."""
    f_lambda_rad: PositiveAngle = Field(alias="f_lambda", default=None, json_schema_extra=_FROM_APERTURE)
    """Angle on the sky of one (f/#)lambda: wavelength over diameter of the illuminated aperture."""
    responsivity_scatter: Share
    """Relative scatter of the detectors' responsivities (log-normal), constant over the survey."""
    camera_rotation_range_rad: AngleExtent = Field(alias="camera_rotation_range")
    """Full range of the camera's rotation angle, drawn uniformly for each observation."""
    illumination: TableOrName = Field(
        default=None,
        json_schema_extra={"otherwise": '"gaussian" with `horn_f_lambda` or `edge_taper`, "uniform" without'},
    )
    """Beam of a pixel over the plane of the stop: "uniform" for an evenly lit stop without spillover, "gaussian",
    "he11" for corrugated horns of the diameter `horn_f_lambda`, or an ECSV table with the columns `rho` and `intensity`
    or `amplitude`, path relative to the scene file. `rho` is the radius over that of the stop, from 0 to 1 or
    beyond."""
    horn_f_lambda: Annotated[float, *number(0.1, 20)] | None = None
    """Diameter of the feed horns in (f/#)lambda, up to the distance between detectors. It sets the beam over the
    stop: the edge taper of a Gaussian beam, or that of an HE11 mode."""
    edge_taper_db: Taper | None = Field(alias="edge_taper", default=None)
    """Edge taper of a Gaussian illumination of the stop; 0 dB is uniform. Alternative: `horn_f_lambda`."""
    efficiency: Annotated[float, *number(1e-4, 1)] | None = None
    """Optical efficiency from window to detector, or with [optics] from its last element to the detector; spillover at
    the stop excluded."""
    polarizations: Annotated[int, *whole(1, 2)] | None = None
    """Number of polarizations that a detector absorbs."""
    layout: Layout | None = None
    """Alternatives: `wafers`, `positions`."""
    wafers: tuple[Wafer, ...] = ()
    """Several wafers, each with a layout. Alternatives: `layout`, `positions`."""
    positions: TableFile = None
    """ECSV or FITS table of detectors with the columns `x` and `y` in angular units, and optional properties of each
    detector; path relative to the scene file. Alternatives: `layout`, `wafers`."""
    table_band: Line | None = Field(alias="band", default=None)
    """Detectors of the table `positions` to simulate, by their value in its column `band`. Required where the table has
    several bands."""

    @cached_property
    def band(self) -> Passband:
        """Passband: of the table or name, or a top hat."""
        if self.passband is not None:
            return read_passband(self.passband)
        return top_hat(self.frequency_hz, self.bandwidth or 0.0)

    @cached_property
    def illumination_table(self) -> IlluminationTable:
        """Beam over the plane of the stop, of the table that `illumination` names."""
        return read_illumination(Path(self.illumination))

    @property
    def table(self) -> DetectorTable | None:
        """Table of detectors; None for a layout or wafers."""
        return None if self.positions is None else detector_table(self.positions)

    @property
    def table_noise(self) -> tuple[str, float] | None:
        """Noise of the band's detectors that the table states, as `DetectorTable.noise`; None without."""
        return None if self.table is None else self.table.noise(self.table_band)

    @property
    def cmb_per_rj(self) -> float:
        """Thermodynamic CMB temperature per Rayleigh-Jeans temperature, averaged over the band."""
        return self.band.cmb_per_rj

    @model_validator(mode="after")
    def _one_band(self) -> Self:
        if (self.frequency_hz is None) == (self.passband is None):
            raise ValueError("exactly one of 'frequency' and 'passband' (a table or a name) is expected")
        if self.passband is not None and self.bandwidth is not None:
            raise ValueError("bandwidth: found together with 'passband', which sets it; one of the two is expected")
        if self.passband is not None:
            try:
                _ = self.band
            except InputError as error:
                raise ValueError(str(error).removeprefix("instrument.")) from None
        return self

    @model_validator(mode="after")
    def _one_focal_plane(self) -> Self:
        if [self.layout is not None, bool(self.wafers), self.positions is not None].count(True) != 1:
            raise ValueError(
                "exactly one of 'layout' (a section), 'wafers' (a list of sections) and 'positions' (a table) is"
                " expected"
            )
        if self.table_band is not None and self.positions is None:
            raise ValueError(f"band: found {self.table_band!r} without 'positions', a table with a column band")
        return self

    @model_validator(mode="after")
    def _one_illumination(self) -> Self:
        beams = {"horn_f_lambda": self.horn_f_lambda, "edge_taper": self.edge_taper_db}
        given = [key for key, value in beams.items() if value is not None]
        if len(given) > 1:
            raise ValueError(
                "edge_taper: found together with 'horn_f_lambda', which sets it; one of the two is expected"
            )
        if self.illumination is not None:
            self._check_illumination(*given)
        return self

    def _check_illumination(self, given: str = "") -> None:
        """Raise ValueError for an unknown illumination, a broken table, and a beam `given` by a key it does not
        have."""
        if isinstance(self.illumination, Path):
            try:
                _ = self.illumination_table
            except InputError as error:
                raise ValueError(str(error).removeprefix("instrument.")) from None
        elif self.illumination not in _BEAM_KEYS:
            raise ValueError(
                f"illumination: found {shown(self.illumination)}; the name of an ECSV file, or one of "
                f"{', '.join(_BEAM_KEYS)} is expected"
            )
        allowed, named = _BEAM_KEYS.get(str(self.illumination), ()), shown(Path(self.illumination).name)
        if given and not allowed:
            raise ValueError(f"{given}: found together with the illumination {named}, which has no such key")
        if allowed and given not in allowed:
            raise ValueError(f"{' or '.join(allowed)}: missing; the illumination {named} needs it")
