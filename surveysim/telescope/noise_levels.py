"""Noise levels of photons and detectors: as the scene states them, or from the optical load in each observation's
weather.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.atmosphere.opacity import BandOpacity, optical_depth
from surveysim.runtime.errors import SceneError
from surveysim.scene.fields import PSD_MAX_MK2_HZ
from surveysim.scene.noise_and_sky import Photon
from surveysim.scene.scene import Scene
from surveysim.telescope.detector_properties import DetectorProperties, table_noise
from surveysim.telescope.focal_plane import total_efficiency
from surveysim.telescope.photon_noise import PhotonNoise, photon_noise, power_per_k


@dataclass(frozen=True)
class WhiteLevels:
    """White-noise levels of one observation, for a detector of the nominal efficiency.

    Attributes
    ----------
    photon_mk2_hz, detector_mk2_hz
        One-sided PSDs.
    shared
        Fraction of the photon noise that overlapping pixels share.
    bose
        Fraction of the photon noise that is photon bunching; None where the scene does not tell.
    """

    photon_mk2_hz: float
    shared: float
    detector_mk2_hz: float
    bose: float | None = None


@dataclass(frozen=True, eq=False)
class WhiteByDetector:
    """White-noise levels (n_det,) of the detectors of a camera [mK^2/Hz]: photon noise that overlapping pixels share,
    photon noise that they do not share, and detector noise.
    """

    shared: np.ndarray
    alone: np.ndarray
    detector: np.ndarray


def white_by_detector(
    levels: WhiteLevels, coherence: str, properties: DetectorProperties, n_det: int
) -> WhiteByDetector:
    """Scale the white noise of a nominal detector to each detector.

    In temperature, shot noise goes as one over the efficiency and bunching does not depend on it. Detector noise of a
    given NEP goes as one over the squared efficiency. Pixels share a fraction of all photon noise with "field"
    `coherence`, and of the bunching alone with any other.
    """
    efficiency = np.ones(n_det) if properties.efficiency is None else properties.efficiency
    noise = np.ones(n_det) if properties.noise is None else properties.noise
    bose = levels.photon_mk2_hz * (1.0 if properties.efficiency is None else levels.bose)
    shot = (levels.photon_mk2_hz - bose) / efficiency
    shared = levels.photon_mk2_hz * levels.shared * np.ones(n_det)
    if coherence == "field":
        shared = levels.shared * (shot + bose)
    power = efficiency**2 if properties.noise_is_power else 1.0
    return WhiteByDetector(shared, shot + bose - shared, levels.detector_mk2_hz * noise / power)


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
    passed = sky_transmission(scene, opacity, pwv_mm, elevation_rad)
    photon, shared, bose = 0.0, 0.0, None
    if scene.photon and scene.photon.load is None:
        photon, shared = scene.photon.psd_mk2_hz, _stated_part(scene.photon)
        bose = scene.photon.bose_fraction
    elif scene.photon:
        sky = scene.photon.load.sky_k
        sky = opacity.temperature_k * (1 - passed) if sky is None else sky
        noise = load_noise(scene, sky, passed)
        photon, shared, bose = noise.psd_mk2_hz, shared_part(scene, sky, noise), bose_part(noise)
    detector, nep = stated_noise(scene)
    if nep is not None:
        per_k = power_per_k(
            scene.instrument.band.width_hz, total_efficiency(scene.instrument), scene.instrument.polarizations
        )
        detector = (1e3 * nep / (per_k * passed)) ** 2
    _check_level("photon.load", photon)
    _check_level("detector.nep", detector)
    return WhiteLevels(photon, shared, detector, bose)


def stated_noise(scene: Scene) -> tuple[float, float | None]:
    """PSD [mK^2/Hz] of the detector noise that the scene or its table states, or else its NEP [W/sqrt(Hz)]."""
    if scene.detector is None:
        return 0.0, None
    if scene.detector.stated is not None:
        return scene.detector.psd_mk2_hz or 0.0, scene.detector.nep_w_rthz
    key, level = table_noise(scene.instrument)
    return (0.0, level) if key == "nep" else (level, None)


def _check_level(key: str, psd_mk2_hz: float) -> None:
    """Raise ValueError for a PSD that is not finite, as under an opaque sky."""
    if not psd_mk2_hz <= PSD_MAX_MK2_HZ:
        raise SceneError(
            f"{key}: found power that is a noise of {psd_mk2_hz:.3g} mK2 / Hz above the atmosphere in this band;"
            f" {PSD_MAX_MK2_HZ:g} mK2 / Hz or less is expected"
        )


def sky_transmission(scene: Scene, opacity: BandOpacity | None, pwv_mm: float, elevation_rad: float) -> float:
    """Transmission of the atmosphere where the photon noise follows from the site's water, else 1.

    A stated load, and a detector NEP without a load, refer to temperatures calibrated above the atmosphere, as in the
    paper.
    """
    of_site = scene.photon and scene.photon.load and scene.photon.load.sky_k is None
    if not of_site:
        return 1.0
    return float(np.exp(-optical_depth(opacity, pwv_mm) / np.sin(elevation_rad)))


def load_noise(scene: Scene, sky_k: float, transmission: float) -> PhotonNoise:
    """Compute the photon noise of a pixel for this sky load, in temperature above the atmosphere."""
    band = scene.instrument
    return photon_noise(
        sky_k + scene.photon.load.optics_k,
        band.band.centre_hz,
        band.band.width_hz / band.band.centre_hz,
        total_efficiency(band),
        polarizations=band.polarizations,
        transmission=transmission,
    )


def shared_part(scene: Scene, sky_k: float, noise: PhotonNoise) -> float:
    """Compute the photon noise that overlapping pixels share: the part of the load through the beam.

    With "field" coherence, shot and Bose noise are shared alike, in proportion to the sky's part of the load (section
    5.1). With "intensity" coherence, only the Bose noise is shared, in proportion to the square of the sky's part
    (Hanbury Brown and Twiss).
    """
    load = sky_k + scene.photon.load.optics_k
    part = sky_k / load if load else 0.0
    return _shared(scene.photon.coherence, part, bose_part(noise))


def bose_part(noise: PhotonNoise) -> float:
    """Fraction of photon noise that is photon bunching."""
    return noise.bose_psd_mk2_hz / noise.psd_mk2_hz if noise.psd_mk2_hz else 0.0


def _stated_part(photon: Photon) -> float:
    """Shared part of photon noise that the scene states as a PSD with its fractions."""
    return _shared(photon.coherence, photon.coherent_fraction, photon.bose_fraction)


def _shared(coherence: str, part: float, bose: float | None) -> float:
    """Shared part of the photon noise from `part`, the fraction of the load through the beam, and `bose`, the fraction
    of the noise that is bunching.
    """
    return part**2 * bose if coherence == "intensity" else part
