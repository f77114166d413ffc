"""Sections of what else is in the time-streams: excess, photon and detector noise, sky."""

import math
from typing import Self

from pydantic import Field, model_validator

from surveysim.quantities import (
    BandPowerExtent,
    Coherence,
    Frequency,
    Latitude,
    Load,
    Longitude,
    Nep,
    NoisePsd,
    Nside,
    Temperature,
    Variances,
)
from surveysim.sections.base import Section, check_knots


class Excess(Section):
    """Excess low-frequency noise: variance below a band limit against B2, spectrum f^-index."""

    spectral_index: float = Field(ge=0, le=10)
    band_limit_hz: Frequency = Field(alias="band_limit")
    b2: tuple[float, ...]
    variance_mk2: Variances = Field(alias="variance")
    coherence: Coherence

    @model_validator(mode="after")
    def _knots_fit(self) -> Self:
        check_knots("b2", self.b2, "variance", self.variance_mk2)
        # Excess is interpolated in the logarithms of both.
        for name, values in (("b2", self.b2), ("variance", self.variance_mk2)):
            if len(self.b2) > 1 and not all(0 < value < math.inf for value in values):
                raise ValueError(f"{name}: found {values}; finite values above 0 are expected")
        return self


class OpticalLoad(Section):
    """The load of a pixel at the cryostat's window, Rayleigh-Jeans.

    `sky` comes through the beam, and neighbours share it; left out, it follows from the site's water in each
    observation. `optics` is scattered in from warm surfaces, of which no two pixels see the same.
    """

    sky_k: Load | None = Field(alias="sky", default=None)
    optics_k: Load = Field(alias="optics")


class Photon(Section):
    """Photon noise, of which a coherent part is shared by overlapping pixels.

    Either a PSD and the part that is coherent, or the load from which both follow.
    """

    psd_mk2_hz: NoisePsd | None = Field(alias="psd", default=None)
    coherent_fraction: float | None = Field(ge=0, le=1, default=None)
    load: OpticalLoad | None = None
    coherence: Coherence

    @model_validator(mode="after")
    def _psd_or_load(self) -> Self:
        if (self.psd_mk2_hz is None) == (self.load is None):
            raise ValueError("exactly one of 'psd' and 'load' (a section) is expected")
        if (self.psd_mk2_hz is None) != (self.coherent_fraction is None):
            found = "missing; 'psd' needs it" if self.load is None else "found beside 'load', which sets it"
            raise ValueError(f"coherent_fraction: {found}")
        return self


class Detector(Section):
    """White noise of detectors and electronics, uncorrelated: a PSD, or a noise-equivalent power."""

    psd_mk2_hz: NoisePsd | None = Field(alias="psd", default=None)
    nep_w_rthz: Nep | None = Field(alias="nep", default=None)

    @model_validator(mode="after")
    def _psd_or_nep(self) -> Self:
        if (self.psd_mk2_hz is None) == (self.nep_w_rthz is None):
            raise ValueError("exactly one of 'psd' and 'nep' is expected")
        return self


class PointSource(Section):
    """A point source: peak Rayleigh-Jeans temperature in the beam."""

    ra_rad: Longitude = Field(alias="ra")
    dec_rad: Latitude = Field(alias="dec")
    peak_mk: Temperature = Field(alias="peak")


class Sky(Section):
    """Astronomical signal in the streams: a flat CMB band power and point sources."""

    cmb_band_power_ukcmb2: BandPowerExtent = Field(alias="cmb_band_power")
    point_sources: tuple[PointSource, ...] = ()
    curved_nside: Nside = None
