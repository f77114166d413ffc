"""Section [sky]: CMB, maps, catalogues, clusters and point sources."""

from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from surveysim.runtime.errors import InputError
from surveysim.scene.catalogue import Catalogue, read_catalogue
from surveysim.scene.fields import (
    AngleExtent,
    BandFrequency,
    BandPowerExtent,
    Flux,
    Latitude,
    Longitude,
    PositiveAngle,
    TableFile,
    Temperature,
    number,
    whole,
)
from surveysim.scene.map_units import UNITS
from surveysim.scene.section import Section
from surveysim.scene.spectrum_file import SpectrumKind, read_spectrum_file
from surveysim.scene.units import shown

SpectralIndex = Annotated[float, *number(-20, 20)]
Unit = Literal[
    "K_RJ", "mK_RJ", "uK_RJ", "K_CMB", "mK_CMB", "uK_CMB", "Jy/sr", "MJy/sr", "Jy/beam", "mJy/beam", "Compton y"
]


class PointSource(Section):
    """Point source, of one temperature in the beam or of a flux density with a power-law spectrum."""

    ra_rad: Longitude = Field(alias="ra")
    """Right ascension (J2000)."""
    dec_rad: Latitude = Field(alias="dec")
    """Declination (J2000)."""
    peak_mk: Temperature | None = Field(alias="peak", default=None)
    """Peak Rayleigh-Jeans temperature in the beam, in any band. Alternative: `flux`."""
    flux_jy: Flux | None = Field(alias="flux", default=None)
    """Flux density at the frequency `flux_frequency`; the mean over the band gives the peak temperature in the beam.
    Alternative: `peak`."""
    flux_frequency_hz: BandFrequency | None = Field(alias="flux_frequency", default=None)
    """Frequency of `flux`. Required with it."""
    spectral_index: SpectralIndex | None = None
    """Index of the flux density as a power of frequency, such as 3.5 for dust. Required with `flux`."""

    @model_validator(mode="after")
    def _one_brightness(self) -> Self:
        if (self.peak_mk is None) == (self.flux_jy is None):
            raise ValueError("exactly one of 'peak' and 'flux' is expected")
        for name in ("flux_frequency", "spectral_index"):
            if (self.flux_jy is None) != (getattr(self, name.replace("frequency", "frequency_hz")) is None):
                found = "found without 'flux'" if self.flux_jy is None else "missing; 'flux' needs it"
                raise ValueError(f"{name}: {found}")
        return self


class SkyMap(Section):
    """Map of the sky in a FITS file: an image with celestial coordinates, or a HEALPix map.

    Its values are taken as samples of the sky at the centres of its pixels. They are convolved with what the beam of
    the camera is wider than the map's own, and averaged over the band.
    """

    map_file: TableFile
    """FITS file, path relative to the scene file."""
    hdu: Annotated[int, *whole(0, 999)] | None = Field(default=None, json_schema_extra={"otherwise": "the first map"})
    """Number of the header-data unit in the file, from 0."""
    unit: Unit | None = Field(
        default=None, json_schema_extra={"otherwise": "that of the file, `BUNIT` or of the column"}
    )
    """Unit of the values. "Compton y" has the spectrum of the thermal Sunyaev-Zeldovich effect, not relativistic."""
    beam_fwhm_rad: AngleExtent | None = Field(
        alias="beam_fwhm", default=None, json_schema_extra={"otherwise": "`BMAJ` and `BMIN` of the file, or 0"}
    )
    """Full width at half maximum of the Gaussian beam that the map is already convolved with, no wider than the
    camera's. Required for "Jy/beam"."""
    frame: Literal["equatorial", "galactic", "ecliptic"] | None = Field(
        default=None, json_schema_extra={"otherwise": "`COORDSYS` of the file"}
    )
    """Coordinates of a HEALPix map whose file does not tell them."""
    frequency_hz: BandFrequency | None = Field(alias="frequency", default=None)
    """Frequency of the values. Required for "Jy/sr" and "Jy/beam". For temperatures it is given with `spectral_index`,
    or left out: the brightness then has a Rayleigh-Jeans spectrum, or that of CMB anisotropy."""
    spectral_index: SpectralIndex | None = None
    """Index of the brightness as a power of frequency, such as 3.5 for dust. Required with `frequency`."""
    missing: Literal["refuse", "zero"] = "refuse"
    """The sky where the map has no value, within the field of the scans: an error, or zero."""

    @model_validator(mode="after")
    def _frequency_fits_unit(self) -> Self:
        if (self.frequency_hz is None) != (self.spectral_index is None):
            name = "frequency" if self.frequency_hz is None else "spectral_index"
            raise ValueError(f"{name}: missing; both or none of 'frequency' and 'spectral_index' are expected")
        if self.unit is not None:
            check_spectrum(self.unit, self.frequency_hz)
        return self


def check_spectrum(unit: str, frequency_hz: float | None) -> None:
    """Raise ValueError for a unit of flux without a frequency, and for Compton y with one."""
    kind = UNITS[unit].kind
    if kind in ("intensity", "flux") and frequency_hz is None:
        raise ValueError(f"frequency: missing; the unit {unit!r} needs it, and 'spectral_index'")
    if kind == "compton" and frequency_hz is not None:
        raise ValueError(f"frequency: found with the unit {unit!r}, whose spectrum is known")


class SkyCatalogue(Section):
    """Catalogue of sources: an ECSV or FITS table with the columns `ra`, `dec` and `flux`, with units.

    Optional columns are `size`, the full width at half maximum of a Gaussian source, `spectral_index` and `name`. Other
    columns are ignored, and so are sources outside the field of the scans.
    """

    catalogue_file: TableFile
    """ECSV or FITS table, path relative to the scene file."""
    flux_frequency_hz: BandFrequency = Field(alias="flux_frequency")
    """Frequency of the flux densities."""
    spectral_index: SpectralIndex | None = None
    """Index of the flux densities as a power of frequency. Required unless the table has a column of it."""

    @property
    def table(self) -> Catalogue:
        """The table, read once."""
        return read_catalogue(self.catalogue_file)

    @model_validator(mode="after")
    def _one_index(self) -> Self:
        try:
            has_column = self.table.spectral_index is not None
        except InputError as error:
            raise ValueError(str(error)) from None
        if has_column == (self.spectral_index is not None):
            found = "found together with a column spectral_index" if has_column else "missing"
            raise ValueError(f"spectral_index: {found}; either the key or a column is expected")
        return self


class SkyCluster(Section):
    """Cluster of galaxies: the thermal Sunyaev-Zeldovich effect of a circular profile, not relativistic."""

    ra_rad: Longitude = Field(alias="ra")
    """Right ascension (J2000) of the centre."""
    dec_rad: Latitude = Field(alias="dec")
    """Declination (J2000) of the centre."""
    y0: Annotated[float, *number(-1, 1)]
    """Compton parameter y of the line of sight through the centre."""
    profile: Literal["arnaud", "beta"]
    """Profile: "arnaud" is the universal pressure profile of Arnaud et al. (2010), "beta" an isothermal cluster."""
    theta_500_rad: PositiveAngle | None = Field(alias="theta_500", default=None)
    """Required by "arnaud": angle of R500."""
    core_radius_rad: PositiveAngle | None = Field(alias="core_radius", default=None)
    """Required by "beta": angle of the core radius theta_c in y0 (1 + theta^2 / theta_c^2)^((1 - 3 beta) / 2)."""
    beta: Annotated[float, *number(0.4, 5)] | None = None
    """Required by "beta": its exponent."""

    @model_validator(mode="after")
    def _keys_of_profile(self) -> Self:
        check_profile(
            self.profile, {"theta_500": self.theta_500_rad, "core_radius": self.core_radius_rad, "beta": self.beta}
        )
        return self


def check_profile(profile: str, given: dict[str, float | None]) -> None:
    """Raise ValueError for keys of a cluster that its profile lacks or does not have."""
    needed = {"arnaud": ("theta_500",), "beta": ("core_radius", "beta")}[profile]
    for key, value in given.items():
        if (value is None) == (key in needed):
            found = "missing; it is expected with" if value is None else "found with"
            raise ValueError(f"{key}: {found} the profile {profile!r}")


_CONTENTS = ("cmb_band_power", "spectrum", "maps", "catalogues", "clusters", "point_sources")


class Sky(Section):
    """Astronomical signal: the sum of a random CMB, maps, catalogues, clusters and point sources."""

    cmb_band_power_ukcmb2: BandPowerExtent | None = Field(alias="cmb_band_power", default=None)
    """Flat CMB band power l (l + 1) C_l / 2 pi, in thermodynamic temperature; 0 for no CMB."""
    spectrum: TableFile = None
    """File of the spectrum of a Gaussian sky, in thermodynamic temperature: columns of CAMB or CLASS, whose temperature
    is taken, two columns, l and l (l + 1) C_l / 2 pi in uK2, or an ECSV table with the columns `ell` and `cl`. It adds
    to `cmb_band_power`. Path relative to the scene file."""
    spectrum_kind: SpectrumKind | None = Field(default=None, json_schema_extra={"otherwise": "that of the header"})
    """Columns of a `spectrum` without a header."""
    maps: tuple[SkyMap, ...] = ()
    """Any number of maps in FITS files."""
    catalogues: tuple[SkyCatalogue, ...] = ()
    """Any number of catalogues of sources."""
    clusters: tuple[SkyCluster, ...] = ()
    """Any number of clusters of galaxies."""
    point_sources: tuple[PointSource, ...] = ()
    """Any number of point sources."""
    curved_lmax: Annotated[int, *whole(2, 30_000)] | None = None
    """Highest multipole of a CMB map on the sphere, for fields too large for the flat-sky approximation; above
    `score.ell_max` if there is a score. Computing time grows with its second to third power."""

    @property
    def spectrum_table(self) -> tuple[np.ndarray, np.ndarray]:
        """Multipoles (n,) and band powers (n,) [uK_CMB^2] of the file `spectrum`."""
        return read_spectrum_file(self.spectrum, self.spectrum_kind)

    def band_power_ukcmb2(self, ell: np.ndarray) -> np.ndarray:
        """Band powers l (l + 1) C_l / 2 pi [uK_CMB^2] of the random sky at some multipoles; 0 off its table."""
        found = np.full(np.shape(ell), self.cmb_band_power_ukcmb2 or 0.0)
        if self.spectrum is not None:
            found += np.interp(ell, *self.spectrum_table, left=0.0, right=0.0)
        return found

    @property
    def is_spectrum(self) -> bool:
        """Return whether the sky has a spectrum and nothing else."""
        return not (self.maps or self.catalogues or self.clusters or self.point_sources)

    @property
    def is_random(self) -> bool:
        """Return whether a part of the sky is drawn at random."""
        return self.cmb_band_power_ukcmb2 is not None or self.spectrum is not None

    @model_validator(mode="before")
    @classmethod
    def _no_nside(cls, data: Any) -> Any:
        if isinstance(data, dict) and "curved_nside" in data:
            raise ValueError("curved_nside: found; the key is 'curved_lmax' now, the highest multipole of the sky")
        return data

    @model_validator(mode="after")
    def _has_content(self) -> Self:
        if self.is_spectrum and not self.is_random:
            raise ValueError(f"found nothing; one or more of {', '.join(map(repr, _CONTENTS))} are expected")
        for key, value in (("curved_lmax", self.curved_lmax), ("spectrum_kind", self.spectrum_kind)):
            if value is not None and not self.is_random:
                raise ValueError(f"{key}: found {shown(value)} without 'cmb_band_power' or 'spectrum'")
        if self.spectrum is None:
            return self
        try:
            _ = self.spectrum_table
        except InputError as error:
            raise ValueError(str(error)) from None
        return self
