"""Noise levels of photons and detectors: as the scene states them, or from the optical load in each observation's
weather.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.atmosphere.opacity import BandOpacity
from surveysim.runtime.errors import SceneError
from surveysim.scene.fields import PSD_MAX_MK2_HZ
from surveysim.scene.noise_and_sky import Photon
from surveysim.scene.scene import Scene
from surveysim.telescope.detector_noise import noise_by_origin, stated_psd_mk2_hz
from surveysim.telescope.detector_properties import DetectorProperties
from surveysim.telescope.optics import scene_chain
from surveysim.telescope.photon_noise import amplitude_weights, chain_noise
from surveysim.telescope.radiative_chain import SKY, RadiativeChain


@dataclass(frozen=True)
class WhiteLevels:
    """White-noise levels of one observation.

    Attributes
    ----------
    photon_mk2_hz, detector_mk2_hz
        One-sided PSDs [mK^2/Hz] of photons, and of detector and readout.
    wave_mk2_hz
        Part of `photon_mk2_hz` that is photon bunching.
    aperture_weight, stop_weight
        Parts of the load, by occupation number at the detector, that come through the aperture of the stop, and from
        the stop.
    shared
        Fraction of `photon_mk2_hz` that a detector would share with another at the same place.
    """

    photon_mk2_hz: float = 0.0
    wave_mk2_hz: float = 0.0
    aperture_weight: float = 0.0
    stop_weight: float = 0.0
    shared: float = 0.0
    detector_mk2_hz: float = 0.0

    @property
    def stop_share(self) -> float:
        """The stop's part of the light that is shared (`surveysim.telescope.pixel_coherence.part_weights`)."""
        return self.stop_weight / (self.aperture_weight + self.stop_weight) if self.stop_weight else 0.0


@dataclass(frozen=True, eq=False)
class WhiteByDetector:
    """White-noise levels (n_det,) of the detectors of a camera [mK^2/Hz]: photon noise that overlapping pixels share,
    photon noise that they do not share, and detector noise.
    """

    shared: np.ndarray
    alone: np.ndarray
    detector: np.ndarray

    @property
    def mean(self) -> float:
        """Mean of all white noise over the detectors."""
        return float(np.mean(self.shared + self.alone + self.detector))


def white_by_detector(
    levels: WhiteLevels, coherence: str, properties: DetectorProperties, n_det: int
) -> WhiteByDetector:
    """Scale the white noise of a nominal detector to each detector.

    In temperature, shot noise goes as one over the efficiency and bunching does not depend on it. Detector noise of a
    given NEP goes as one over the squared efficiency. Pixels share a fraction of all photon noise with "field"
    `coherence`, and of the bunching alone with any other.
    """
    photon, shared = np.full(n_det, levels.photon_mk2_hz), np.full(n_det, levels.shared * levels.photon_mk2_hz)
    detector = levels.detector_mk2_hz * (np.ones(n_det) if properties.noise is None else properties.noise)
    if properties.efficiency is not None:
        photon = (levels.photon_mk2_hz - levels.wave_mk2_hz) / properties.efficiency + levels.wave_mk2_hz
        shared = levels.shared * photon if coherence == "field" else shared
        detector = detector / properties.efficiency**2 if properties.noise_is_power else detector
    return WhiteByDetector(shared, photon - shared, detector)


def white_levels(scene: Scene, opacity: BandOpacity | None, pwv_mm: float, elevation_rad: float) -> WhiteLevels:
    """Compute the white-noise levels of one observation; components that the scene leaves out have 0.

    Parameters
    ----------
    opacity
        Opacity of the site in the band; None without a site.
    pwv_mm
        Precipitable water of the observation.
    elevation_rad
        Mean elevation of the observation.
    """
    chain = scene_chain(scene, opacity, pwv_mm, elevation_rad) if scene.given_by_power else None
    if scene.photon and scene.photon.psd_mk2_hz is not None:
        levels = _stated(scene.photon)
    elif scene.photon and chain:
        levels = _of_chain(chain, scene.photon.coherence)
    else:
        levels = {}
    detector = stated_psd_mk2_hz(scene)
    if detector is None:
        detector = _detector_psd(scene, chain)
    _check_level(scene.given_by_power, levels.get("photon_mk2_hz", 0.0))
    _check_level("detector", detector)
    return WhiteLevels(**levels, detector_mk2_hz=detector)


def _check_level(key: str | None, psd_mk2_hz: float) -> None:
    """Raise ValueError for a PSD that is not finite, as under an opaque sky."""
    if not psd_mk2_hz <= PSD_MAX_MK2_HZ:
        raise SceneError(
            f"{key}: found power that is a noise of {psd_mk2_hz:.3g} mK2 / Hz above the atmosphere in this band;"
            f" {PSD_MAX_MK2_HZ:g} mK2 / Hz or less is expected"
        )


def _detector_psd(scene: Scene, chain: RadiativeChain) -> float:
    """Detector noise [mK^2/Hz] of a detector whose NEP is known, under the load of the chain."""
    nep2 = sum(noise_by_origin(scene, chain_noise(chain).power_w).values())
    return nep2 * (1e3 / chain.w_per_k) ** 2 if chain.w_per_k else float("inf")


def _stated(photon: Photon) -> dict[str, float]:
    """Levels of photon noise that the scene states as a PSD with its fractions."""
    part, stop, wave = photon.coherent_fraction, photon.stop_fraction or 0.0, photon.bose_fraction or 0.0
    return {
        "photon_mk2_hz": photon.psd_mk2_hz,
        "wave_mk2_hz": wave * photon.psd_mk2_hz,
        "aperture_weight": part,
        "stop_weight": stop,
        "shared": _shared(photon.coherence, part + stop, wave),
    }


def _of_chain(chain: RadiativeChain, coherence: str) -> dict[str, float]:
    """Levels of photon noise from the load.

    With "field" coherence, shot and wave noise are shared alike, in proportion to the part of the load through the beam
    (section 5.1). With "hbt" coherence, only the wave noise is shared, in proportion to the square of the part through
    the aperture and from the stop (Hill and Kusaka 2024, equation 59).
    """
    noise = chain_noise(chain)
    aperture, stop = amplitude_weights(chain)
    wave = noise.bose_nep2 / (noise.shot_nep2 + noise.bose_nep2) if noise.power_w else 0.0
    part = aperture + stop
    if coherence == "field":
        part = float(chain.power_w(chain.occupation_of(SKY))) / noise.power_w if noise.power_w else 0.0
    return {
        "photon_mk2_hz": noise.psd_mk2_hz,
        "wave_mk2_hz": noise.bose_psd_mk2_hz,
        "aperture_weight": aperture,
        "stop_weight": stop,
        "shared": _shared(coherence, part, wave),
    }


def _shared(coherence: str, part: float, wave: float) -> float:
    """Shared fraction of the photon noise, from the `part` of the load that is coherent between pixels, and the
    fraction `wave` of the noise that is bunching.
    """
    return part**2 * wave if coherence == "hbt" else part


def stop_emits(scene: Scene) -> bool:
    """Return whether light of the stop is part of the load, as far as the beam spills on it."""
    return bool(scene.photon and (scene.photon.stop_fraction or (scene.optics and scene.optics.stop)))
