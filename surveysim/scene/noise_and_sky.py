"""Sections [excess], [photon] and [detector]: noise in the time-streams; and the list of all components' sections."""

from typing import Annotated, Self

from pydantic import Field, model_validator

from surveysim.scene.atmosphere import Atmosphere
from surveysim.scene.fields import (
    B2_MAX,
    B2Knots,
    Coherence,
    Conductance,
    Energy,
    Frequency,
    Load,
    Nep,
    NoisePsd,
    PhotonCoherence,
    PhysicalTemperature,
    Share,
    Variances,
    number,
)
from surveysim.scene.section import Section, check_knots
from surveysim.scene.sky import Sky
from surveysim.scene.units import shown


class Excess(Section):
    """Excess low-frequency noise with a power-law spectrum and a variance that depends on B2."""

    spectral_index: Annotated[float, *number(0, 10)]
    """Spectral index: the PSD is proportional to f to minus this power."""
    band_limit_hz: Frequency = Field(alias="band_limit")
    """Upper limit of the frequencies that `variance` includes."""
    b2: B2Knots
    """Values of B2 [mK^2 rad^(2 - index)] at which the variance is given. A single value makes the variance independent
    of the weather."""
    variance_mk2: Variances = Field(alias="variance")
    """Variance of a mean-removed scan at each `b2`; interpolated linearly in logarithms, constant beyond the ends."""
    coherence: Coherence
    """Correlation between overlapping pixels: "field" is the field coherence gamma, "intensity" its square, "none" no
    correlation."""

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
    """Optical load of a pixel at the cryostat window, in Rayleigh-Jeans temperature.

    Noise temperatures refer to the sky above the atmosphere. The transmission of the atmosphere follows from the site;
    where `sky` is given it is 1.
    """

    sky_k: Load | None = Field(alias="sky", default=None, json_schema_extra={"otherwise": "that of the site's water"})
    """Load through the beam, coherent between overlapping pixels. Without it, `atmosphere.site` is required."""
    optics_k: Load = Field(alias="optics")
    """Load from warm optics, uncorrelated between pixels."""


class Photon(Section):
    """Photon noise, correlated between overlapping pixels.

    Given by a PSD and its coherent fraction, or by the optical load, which determines both: `load`, or that of the
    section [optics] without `psd` and `load`.
    """

    psd_mk2_hz: NoisePsd | None = Field(alias="psd", default=None)
    """One-sided PSD of a detector's photon noise, in Rayleigh-Jeans temperature. Alternatives: `load`, [optics]."""
    coherent_fraction: Share | None = None
    """Fraction of the load that comes through the beam. Required with `psd`, not allowed without it."""
    stop_fraction: Share | None = Field(default=None, json_schema_extra={"otherwise": "0"})
    """Fraction of the load that the stop emits, where the beam spills over its edge. For `psd` with coherence "hbt"."""
    bose_fraction: Share | None = None
    """Fraction of the noise `psd` that is photon bunching (Bose or wave noise) instead of shot noise. Required with
    `psd` and coherence "hbt"."""
    load: OpticalLoad | None = None
    """Alternatives: `psd`, [optics]."""
    coherence: PhotonCoherence
    """Correlation between pixels: "hbt" correlates the bunching of light through the aperture and of the stop (Hanbury
    Brown and Twiss; Hill and Kusaka 2024). "field" correlates all noise of the load through the beam by the field
    coherence gamma, the hypothesis of Sayers et al. (2010) for their excess noise. "none" correlates nothing."""

    @model_validator(mode="after")
    def _psd_or_load(self) -> Self:
        if self.psd_mk2_hz is not None and self.load is not None:
            raise ValueError("one of 'psd' and 'load' (a section) is expected, or neither with a section [optics]")
        source = "'load'" if self.load else "[optics]"
        if self.psd_mk2_hz is not None and self.coherent_fraction is None:
            raise ValueError("coherent_fraction: missing; 'psd' needs it")
        for name in ("coherent_fraction", "stop_fraction", "bose_fraction"):
            if self.psd_mk2_hz is None and getattr(self, name) is not None:
                raise ValueError(f"{name}: found without 'psd'; {source} sets it")
        if self.psd_mk2_hz is not None and self.coherence == "hbt" and self.bose_fraction is None:
            raise ValueError(
                "bose_fraction: missing; 'psd' with coherence 'hbt' needs it, as the bunching alone is shared: "
                "0 for shot noise alone to 1, or give a 'load', from which it follows"
            )
        return self

    @model_validator(mode="after")
    def _stop_is_of_load(self) -> Self:
        if self.stop_fraction is None:
            return self
        if self.coherence != "hbt":
            raise ValueError("stop_fraction: found without coherence 'hbt', which it belongs to")
        if self.coherent_fraction + self.stop_fraction > 1 + 1e-9:
            raise ValueError(
                f"stop_fraction: found {self.stop_fraction:g} with a coherent_fraction of {self.coherent_fraction:g}; "
                "1 or less is expected of their sum"
            )
        return self


class Bolometer(Section):
    """Bolometer: thermal fluctuation (phonon) noise of its link to the bath, and amplifier noise.

    The link has the conductance ``G (T / T_c)^exponent``.
    """

    conductance_w_k: Conductance = Field(alias="conductance")
    """Thermal conductance G = dP/dT of the link at the critical temperature."""
    critical_temperature_k: PhysicalTemperature = Field(alias="critical_temperature")
    """Temperature of the bolometer: critical temperature T_c of the thermistor."""
    bath_temperature_k: PhysicalTemperature = Field(alias="bath_temperature")
    """Temperature of the bath, below the critical temperature."""
    exponent: Annotated[float, *number(0, 10)]
    """Exponent of the conductance in temperature: 1 for a metal, 3 for a crystalline insulator."""
    amplifier_nep_w_rthz: Nep = Field(alias="amplifier_nep")
    """NEP of the readout: amplifier and Johnson noise; 0 for none."""

    @model_validator(mode="after")
    def _bath_is_colder(self) -> Self:
        if not self.bath_temperature_k < self.critical_temperature_k:
            raise ValueError(
                f"bath_temperature: found {self.bath_temperature_k:g} K; less than the critical temperature, "
                f"{self.critical_temperature_k:g} K, is expected"
            )
        return self


class Kid(Section):
    """Kinetic inductance detector: recombination noise of the quasiparticles that the load breaks, and amplifier and
    two-level-system noise."""

    gap_j: Energy = Field(alias="gap")
    """Gap energy Delta of the superconductor: half of the energy that breaks a pair."""
    pair_breaking_efficiency: Annotated[float, *number(0.01, 1)]
    """Share of the absorbed energy that goes into quasiparticles."""
    amplifier_nep_w_rthz: Nep = Field(alias="amplifier_nep")
    """NEP of amplifier and two-level systems; 0 for none."""


ONE_NOISE = "exactly one of 'psd', 'nep', 'bolometer' and 'kid' is expected"


class Detector(Section):
    """White noise of detectors and readout, uncorrelated between detectors."""

    psd_mk2_hz: NoisePsd | None = Field(alias="psd", default=None)
    """One-sided white-noise PSD of a detector, in Rayleigh-Jeans temperature. Alternatives: `nep`, `bolometer`, `kid`,
    or a column `psd` or `nep` of the table `instrument.positions`."""
    nep_w_rthz: Nep | None = Field(alias="nep", default=None)
    """Noise-equivalent power (NEP) of a detector. Alternatives: as for `psd`."""
    bolometer: Bolometer | None = None
    """Alternatives: `psd`, `nep`, `kid`."""
    kid: Kid | None = None
    """Alternatives: `psd`, `nep`, `bolometer`. Its noise depends on the load: a `photon.load` or [optics] is
    required."""

    @model_validator(mode="after")
    def _one_noise(self) -> Self:
        if [self.psd_mk2_hz, self.nep_w_rthz, self.bolometer, self.kid].count(None) < 3:
            raise ValueError(ONE_NOISE)
        return self

    @property
    def stated(self) -> str | None:
        """Key that states the noise; None where the table of detectors does."""
        keys = {"psd": self.psd_mk2_hz, "nep": self.nep_w_rthz, "bolometer": self.bolometer, "kid": self.kid}
        return next((key for key, value in keys.items() if value is not None), None)


class StreamSections(Section):
    """Sections of the components of the time-streams; each can be left out."""

    atmosphere: Atmosphere | None = None
    """Without it there is neither a turbulent layer nor weather."""
    excess: Excess | None = None
    photon: Photon | None = None
    detector: Detector | None = None
    sky: Sky | None = None
    """Without it the time-streams are noise only."""
