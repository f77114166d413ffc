"""Sections of what else is in the time-streams: excess, photon and detector noise, sky."""

from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.fields import (
    B2_MAX,
    B2Knots,
    BandPowerExtent,
    Coherence,
    Frequency,
    Latitude,
    Load,
    Longitude,
    Nep,
    NoisePsd,
    Share,
    Temperature,
    Variances,
    number,
    whole,
)
from surveysim.scene.section import Section, check_knots
from surveysim.scene.units import shown


class Excess(Section):
    """Excess low-frequency noise: variance below a band limit against B2, spectrum f^-index."""

    spectral_index: Annotated[float, *number(0, 10)]
    """The spectrum goes as f to minus this."""
    band_limit_hz: Frequency = Field(alias="band_limit")
    """The variance is that below this frequency."""
    b2: B2Knots
    """Values of B2 [mK^2 rad^(2 - index)] for which the variance is given; one value: it is the same in any weather."""
    variance_mk2: Variances = Field(alias="variance")
    """Variance of a mean-removed scan at each: between them interpolated in logarithms, beyond them constant."""
    coherence: Coherence
    """What pixels share by overlap: gamma of the field, the hypothesis of Sayers et al. (2010); gamma squared, as were
    all of it bunching of light through the beam; or nothing. All three are assumptions: its origin is not known."""

    @model_validator(mode="after")
    def _knots_fit(self) -> Self:
        check_knots("b2", self.b2, "variance", self.variance_mk2)
        if not all(0 <= value <= B2_MAX for value in self.b2):
            raise ValueError(f"b2: found {shown(self.b2)}; finite values of {B2_MAX:g} or less are expected")
        # Excess is interpolated in the logarithms of both.
        for name, values in (("b2", self.b2), ("variance", self.variance_mk2)):
            if len(self.b2) > 1 and not min(values) > 0:
                raise ValueError(f"{name}: found {shown(values)}; finite values above 0 are expected")
        return self


class OpticalLoad(Section):
    """The load of a pixel at the cryostat's window, Rayleigh-Jeans.

    Noise is in temperature above the atmosphere. Where the sky's load follows from the site, so does the transmission
    that this takes; with a load that is stated it is taken as 1.
    """

    sky_k: Load | None = Field(alias="sky", default=None, json_schema_extra={"otherwise": "that of the site's water"})
    """Load through the beam, which neighbours share; without it a site is needed."""
    optics_k: Load = Field(alias="optics")
    """Load scattered in from warm surfaces, of which no two pixels see the same."""


class Photon(Section):
    """Photon noise, of which a coherent part is shared by overlapping pixels.

    Either a PSD and the part that is coherent, or the load from which both follow.
    """

    psd_mk2_hz: NoisePsd | None = Field(alias="psd", default=None)
    """Photon noise of a detector, white, one-sided, in Rayleigh-Jeans temperature. Or `load`."""
    coherent_fraction: Share | None = None
    """Share of the load that comes through the beam, where pixels overlap; with `psd` only."""
    bose_fraction: Share | None = None
    """Share of the noise `psd` that is bunching (Bose), not shot noise. Needed with `psd` and coherence "intensity"."""
    load: OpticalLoad | None = None
    """The load from which the noise follows. Or `psd`."""
    coherence: Coherence
    """What pixels share by overlap: of all noise of the load through the beam gamma of the field, the hypothesis of
    Sayers et al. (2010); of the bunching alone, which goes as the square of that load, gamma squared (Hanbury Brown and
    Twiss); or nothing."""

    @model_validator(mode="after")
    def _psd_or_load(self) -> Self:
        if (self.psd_mk2_hz is None) == (self.load is None):
            raise ValueError("exactly one of 'psd' and 'load' (a section) is expected")
        if (self.psd_mk2_hz is None) != (self.coherent_fraction is None):
            found = "missing; 'psd' needs it" if self.load is None else "found beside 'load', which sets it"
            raise ValueError(f"coherent_fraction: {found}")
        if self.load is not None and self.bose_fraction is not None:
            raise ValueError("bose_fraction: found beside 'load', which sets it")
        if self.load is None and self.coherence == "intensity" and self.bose_fraction is None:
            raise ValueError(
                "bose_fraction: missing; 'psd' with coherence 'intensity' needs it, as the bunching alone is shared: "
                "0 for shot noise alone to 1, or give a 'load', from which it follows"
            )
        return self


class Detector(Section):
    """White noise of detectors and electronics, uncorrelated: a PSD, or a noise-equivalent power."""

    psd_mk2_hz: NoisePsd | None = Field(alias="psd", default=None)
    """White noise of a detector, one-sided, in Rayleigh-Jeans temperature. Or `nep`."""
    nep_w_rthz: Nep | None = Field(alias="nep", default=None)
    """Noise-equivalent power. Or `psd`."""

    @model_validator(mode="after")
    def _psd_or_nep(self) -> Self:
        if (self.psd_mk2_hz is None) == (self.nep_w_rthz is None):
            raise ValueError("exactly one of 'psd' and 'nep' is expected")
        return self


class PointSource(Section):
    """A point source: peak Rayleigh-Jeans temperature in the beam."""

    ra_rad: Longitude = Field(alias="ra")
    """Right ascension (J2000)."""
    dec_rad: Latitude = Field(alias="dec")
    """Declination (J2000)."""
    peak_mk: Temperature = Field(alias="peak")
    """Peak in the beam, Rayleigh-Jeans."""


class Sky(Section):
    """Astronomical signal in the streams: a flat CMB band power and point sources."""

    cmb_band_power_ukcmb2: BandPowerExtent = Field(alias="cmb_band_power")
    """Flat CMB band power l (l + 1) C_l / 2 pi, in thermodynamic temperature; 0 for none."""
    point_sources: tuple[PointSource, ...] = ()
    """Any number of them."""
    curved_lmax: Annotated[int, *whole(2, 30_000)] | None = None
    """Make the CMB on the sphere, up to this multipole, for fields too large for a plane; with a score, above its
    `ell_max`. Time grows as its square times the field's size, or as its cube."""

    @model_validator(mode="before")
    @classmethod
    def _no_nside(cls, data: Any) -> Any:
        if isinstance(data, dict) and "curved_nside" in data:
            raise ValueError("curved_nside: found; the key is 'curved_lmax' now, the highest multipole of the sky")
        return data


class StreamSections(Section):
    """Sections of the components of time-streams, each left out with its section."""

    atmosphere: Atmosphere | None = None
    """Left out: no layer, no weather."""
    excess: Excess | None = None
    photon: Photon | None = None
    detector: Detector | None = None
    sky: Sky | None = None
    """Left out: noise alone."""
