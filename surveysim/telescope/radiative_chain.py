"""Radiation from the sky to a detector: occupation number that each surface adds, and transmission to the absorber.

One spatial mode in one or two polarizations. A surface passes a part of what it receives and adds its own emission:
``n_out = t n_in + e n(T)``, with the occupation number ``n(T) = 1 / (exp(h nu / k T) - 1)`` of a black body.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surveysim.scene.passband import Passband
from surveysim.scene.units import BOLTZMANN_J_K, CMB_TEMPERATURE_K, PLANCK_J_S

SKY, STOP, DETECTOR = "sky", "stop", "detector"  # sides of the surfaces that emit


@dataclass(frozen=True, eq=False)
class Surface:
    """Surface that radiation passes on its way to the detector.

    Attributes
    ----------
    name
    side
        "sky" before the stop, "stop" for the stop itself, "detector" behind it.
    temperature_k
        Physical temperature; None where the emission is stated.
    emitted : (n,)
        Occupation number that the surface adds, at the nodes of the band.
    transmission : (n,)
        Part of the radiation from before it that it passes.
    """

    name: str
    side: str
    temperature_k: float | None
    emitted: np.ndarray
    transmission: np.ndarray


@dataclass(frozen=True, eq=False)
class RadiativeChain:
    """Surfaces from above the atmosphere to the absorber.

    Attributes
    ----------
    band
        Passband; its nodes are the frequencies of the surfaces.
    polarizations
        Number of polarizations that the detector absorbs.
    surfaces
        Surfaces in the order that radiation passes them.
    """

    band: Passband
    polarizations: int
    surfaces: tuple[Surface, ...]

    @cached_property
    def to_detector(self) -> np.ndarray:
        """Transmission (n_surface, n) from the output of each surface to the absorber."""
        after = np.ones_like(self.band.nodes[0])
        found = []
        for surface in reversed(self.surfaces):
            found.append(after)
            after = after * surface.transmission
        return np.array(found[::-1])

    @cached_property
    def occupation(self) -> np.ndarray:
        """Occupation number (n_surface, n) that each surface adds at the absorber."""
        return np.array([surface.emitted for surface in self.surfaces]) * self.to_detector

    @cached_property
    def transmission(self) -> np.ndarray:
        """Transmission (n,) from above the atmosphere to the absorber."""
        return self.to_detector[0] * self.surfaces[0].transmission

    def occupation_of(self, *sides: str) -> np.ndarray:
        """Occupation number (n,) at the absorber from the surfaces of some sides."""
        chosen = [surface.side in sides for surface in self.surfaces]
        return self.occupation[chosen].sum(axis=0)

    @property
    def photon_energy_j(self) -> np.ndarray:
        """Photon energy h nu (n,)."""
        return PLANCK_J_S * self.band.nodes[0]

    def band_integral(self, density: np.ndarray) -> np.ndarray:
        """Integral over the band [Hz] of a density (..., n) times the transmission of the band, whose peak is 1."""
        return self.band.width_hz * (density @ self.band.nodes[1])

    def power_w(self, occupation: np.ndarray) -> np.ndarray:
        """Absorbed power [W] of an occupation number (..., n) at the absorber, ``n_pol int h nu n dnu``."""
        return self.polarizations * self.band_integral(self.photon_energy_j * occupation)

    def shot_nep2(self, occupation: np.ndarray) -> np.ndarray:
        """Shot noise [W^2/Hz], ``2 int h nu P_nu dnu`` (Richards 1994)."""
        return 2 * self.polarizations * self.band_integral(self.photon_energy_j**2 * occupation)

    def wave_nep2(self, occupation: np.ndarray) -> np.ndarray:
        """Wave (Bose) noise [W^2/Hz], ``2 int P_nu^2 dnu / n_pol`` (Richards 1994, Zmuidzinas 2003).

        Polarizations bunch by themselves: two share the power and their noises add in squares.
        """
        passed = self.band.at(self.band.nodes[0])
        return 2 * self.polarizations * self.band_integral(passed * (self.photon_energy_j * occupation) ** 2)

    def wave_average(self, value: np.ndarray) -> float:
        """Average of a value (n,) over the band, weighted by the wave noise; 0 without noise."""
        passed = self.band.at(self.band.nodes[0])
        weight = self.band.nodes[1] * passed * (self.photon_energy_j * self.occupation.sum(axis=0)) ** 2
        return float(value @ weight / weight.sum()) if weight.sum() else 0.0

    @property
    def w_per_k(self) -> float:
        """Absorbed power per Rayleigh-Jeans temperature above the atmosphere [W/K]."""
        return float(self.polarizations * BOLTZMANN_J_K * self.band_integral(self.transmission))

    @property
    def w_per_k_cmb(self) -> float:
        """Absorbed power per thermodynamic CMB temperature above the atmosphere [W/K]."""
        x = self.photon_energy_j / (BOLTZMANN_J_K * CMB_TEMPERATURE_K)
        rj_per_cmb = np.exp(x) * (x / np.expm1(x)) ** 2
        return float(self.polarizations * BOLTZMANN_J_K * self.band_integral(self.transmission * rj_per_cmb))


def black_body(frequency_hz: np.ndarray, temperature_k: float) -> np.ndarray:
    """Occupation number (n,) of a black body."""
    x = PLANCK_J_S * frequency_hz / (BOLTZMANN_J_K * temperature_k)
    return np.exp(-x) / -np.expm1(-x)  # of cold surfaces e^x would be too large a number


def rayleigh_jeans(frequency_hz: np.ndarray, temperature_k: float) -> np.ndarray:
    """Occupation number (n,) of a Rayleigh-Jeans temperature, ``k T / h nu``."""
    return BOLTZMANN_J_K * temperature_k / (PLANCK_J_S * frequency_hz)


def emitter(
    name: str,
    side: str,
    temperature_k: float,
    frequency_hz: np.ndarray,
    *,
    transmission: np.ndarray | float,
    emissivity: np.ndarray | float | None = None,
) -> Surface:
    """Make a surface that emits `emissivity` of a black body; by default all that it does not pass."""
    passed = np.broadcast_to(transmission, frequency_hz.shape)
    emissivity = 1 - passed if emissivity is None else emissivity
    return Surface(name, side, temperature_k, emissivity * black_body(frequency_hz, temperature_k), passed)


def stated(name: str, side: str, rj_k: float, frequency_hz: np.ndarray, transmission: float = 1.0) -> Surface:
    """Make a surface whose emission is stated in Rayleigh-Jeans temperature."""
    passed = np.full(frequency_hz.shape, transmission)
    return Surface(name, side, None, rayleigh_jeans(frequency_hz, rj_k), passed)


def coupling(frequency_hz: np.ndarray, efficiency: float) -> Surface:
    """Make the coupling of the detector, which emits nothing."""
    return Surface("detector", DETECTOR, None, np.zeros(frequency_hz.shape), np.full(frequency_hz.shape, efficiency))
