"""Sections of what else is in the time-streams: excess, photon and detector noise, sky."""

import math
from typing import Self

from pydantic import Field, model_validator

from surveysim.quantities import (
    BandPowerExtent,
    Coherence,
    Frequency,
    Latitude,
    Longitude,
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


class Photon(Section):
    """Photon noise, of which a coherent part is shared by overlapping pixels."""

    psd_mk2_hz: NoisePsd = Field(alias="psd")
    coherent_fraction: float = Field(ge=0, le=1)
    coherence: Coherence


class Detector(Section):
    """White noise of detectors and electronics, uncorrelated."""

    psd_mk2_hz: NoisePsd = Field(alias="psd")


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
