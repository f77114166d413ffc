"""Sensitivity of a detector: its load and noise by origin, as NEP, NET and NEFD."""

import math
from dataclasses import dataclass

import numpy as np

from surveysim.atmosphere.opacity import BandOpacity
from surveysim.scene.scene import Scene
from surveysim.scene.units import BOLTZMANN_J_K
from surveysim.telescope.detector_noise import noise_by_origin, saturation_power_w, stated_psd_mk2_hz
from surveysim.telescope.diffraction import effective_area_m2
from surveysim.telescope.optics import scene_chain
from surveysim.telescope.photon_noise import chain_noise
from surveysim.telescope.radiative_chain import RadiativeChain

MJY = 1e-29  # W / m^2 / Hz


@dataclass(frozen=True)
class ElementLoad:
    """Load of a detector by one surface.

    Attributes
    ----------
    name, side, temperature_k
        As in the scene; no temperature where the emission is stated.
    load_w
        Absorbed power.
    occupation
        Mean occupation number at the absorber over the band.
    transmission
        Mean transmission from the surface to the absorber over the band.
    nep2
        Part of the squared photon NEP [W^2/Hz]: shot noise, and wave noise in proportion to the occupation number.
    """

    name: str
    side: str
    temperature_k: float | None
    load_w: float
    occupation: float
    transmission: float
    nep2: float


@dataclass(frozen=True)
class Sensitivity:
    """Load and noise of a detector under one sky.

    Attributes
    ----------
    pwv_mm, elevation_rad
        Precipitable water, NaN without a site, and elevation.
    elements
        Surfaces that emit, from the sky to the detector.
    nep2
        Squared NEPs [W^2/Hz] by origin.
    w_per_k, w_per_k_cmb
        Absorbed power per temperature above the atmosphere [W/K], Rayleigh-Jeans and thermodynamic CMB.
    w_per_mjy
        Absorbed power per flux density of a point source above the atmosphere [W/mJy].
    saturation_w
        Load that saturates the bolometer; None where it is unknown.
    """

    pwv_mm: float
    elevation_rad: float
    elements: tuple[ElementLoad, ...]
    nep2: dict[str, float]
    w_per_k: float
    w_per_k_cmb: float
    w_per_mjy: float
    saturation_w: float | None

    @property
    def load_w(self) -> float:
        """Absorbed power of all surfaces."""
        return sum(element.load_w for element in self.elements)

    @property
    def nep_w_rthz(self) -> float:
        """NEP of all origins."""
        return math.sqrt(sum(self.nep2.values()))

    @property
    def net_mk_rts(self) -> float:
        """NET in Rayleigh-Jeans temperature [mK sqrt(s)], ``NEP / (sqrt(2) dP/dT)``."""
        return 1e3 * self.nep_w_rthz / (math.sqrt(2) * self.w_per_k)

    @property
    def net_mkcmb_rts(self) -> float:
        """NET in CMB temperature [mK sqrt(s)]."""
        return 1e3 * self.nep_w_rthz / (math.sqrt(2) * self.w_per_k_cmb)

    @property
    def nefd_mjy_rts(self) -> float:
        """Noise-equivalent flux density (NEFD) of a point source [mJy sqrt(s)]."""
        return self.nep_w_rthz / (math.sqrt(2) * self.w_per_mjy)

    @property
    def saturates(self) -> bool:
        """Return whether the load is at or above the saturation power."""
        return self.saturation_w is not None and self.load_w >= self.saturation_w


def sensitivity(scene: Scene, opacity: BandOpacity | None, pwv_mm: float, elevation_rad: float) -> Sensitivity:
    """Compute the sensitivity of a detector of a scene whose photon noise follows from a load.

    A point source of flux density S gives ``A_eff S / 2`` in each polarization, as does the Rayleigh-Jeans temperature
    ``A_eff S / 2 k`` that fills the beam.

    Parameters
    ----------
    opacity
        Opacity of the site in the band; None without a site.
    pwv_mm
        Precipitable water.
    elevation_rad
        Elevation.
    """
    chain = scene_chain(scene, opacity, pwv_mm, elevation_rad)
    noise = chain_noise(chain)
    nep2 = {"shot": noise.shot_nep2, "wave": noise.bose_nep2}
    nep2 |= noise_by_origin(scene, noise.power_w)
    if psd := stated_psd_mk2_hz(scene):
        nep2["detector"] = psd * (1e-3 * noise.w_per_k) ** 2
    bolometer = scene.detector.bolometer if scene.detector else None
    return Sensitivity(
        pwv_mm,
        elevation_rad,
        tuple(_elements(chain)),
        nep2,
        noise.w_per_k,
        noise.w_per_k_cmb,
        noise.w_per_k * effective_area_m2(scene) * MJY / (2 * BOLTZMANN_J_K),
        saturation_power_w(bolometer) if bolometer else None,
    )


def _elements(chain: RadiativeChain) -> list[ElementLoad]:
    total, weight = chain.occupation.sum(axis=0), chain.band.nodes[1]
    wave = chain.wave_nep2(np.sqrt(total * chain.occupation))
    nep2 = chain.shot_nep2(chain.occupation) + wave
    columns = chain.surfaces, chain.power_w(chain.occupation), chain.occupation, chain.to_detector, nep2
    return [
        ElementLoad(
            surface.name,
            surface.side,
            surface.temperature_k,
            float(load),
            float(occupation @ weight),
            float(passed @ weight),
            float(part),
        )
        for surface, load, occupation, passed, part in zip(*columns, strict=True)
        if surface.emitted.any()
    ]
