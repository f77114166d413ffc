"""Noise levels of photons and detectors: as the scene states them, or from the optical load in each observation's
weather.
"""

from dataclasses import dataclass

import numpy as np

from surveysim.atmosphere.opacity import BandOpacity, optical_depth
from surveysim.runtime.errors import SceneError
from surveysim.scene.fields import PSD_MAX_MK2_HZ
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import total_efficiency
from surveysim.telescope.photon_noise import PhotonNoise, photon_noise, power_per_k


@dataclass(frozen=True)
class WhiteLevels:
    """White-noise levels of one observation.

    Attributes
    ----------
    photon_mk2_hz, detector_mk2_hz
        One-sided PSDs of a detector.
    shared
        Fraction of the photon noise that a detector would share with another at the same place.
    stop_share
        The stop's part of the light that is shared (`surveysim.telescope.pixel_coherence.part_weights`).
    """

    photon_mk2_hz: float
    shared: float
    detector_mk2_hz: float
    stop_share: float = 0.0


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
    photon, shared, stop = 0.0, 0.0, 0.0
    if scene.photon and scene.photon.load is None:
        photon, stop = scene.photon.psd_mk2_hz, scene.photon.stop_fraction or 0.0
        shared = _shared(scene.photon.coherence, scene.photon.coherent_fraction + stop, scene.photon.bose_fraction)
        stop /= scene.photon.coherent_fraction + stop or 1.0
    elif scene.photon:
        sky = scene.photon.load.sky_k
        sky = opacity.temperature_k * (1 - passed) if sky is None else sky
        noise = load_noise(scene, sky, passed)
        photon, shared = noise.psd_mk2_hz, shared_part(scene, sky, noise)
    detector = scene.detector.psd_mk2_hz if scene.detector else 0.0
    if detector is None:
        per_k = power_per_k(
            scene.instrument.band.width_hz, total_efficiency(scene.instrument), scene.instrument.polarizations
        )
        detector = (1e3 * scene.detector.nep_w_rthz / (per_k * passed)) ** 2
    _check_level("photon.load", photon)
    _check_level("detector.nep", detector)
    return WhiteLevels(photon, shared, detector, stop)


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
    """Compute the fraction of the photon noise that overlapping pixels share, from the load through the beam.

    With "field" coherence, shot and Bose noise are shared alike, in proportion to the sky's part of the load (section
    5.1). With "hbt" coherence, only the Bose noise is shared, in proportion to the square of the sky's part (Hill and
    Kusaka 2024, equation 59).
    """
    load = sky_k + scene.photon.load.optics_k
    part = sky_k / load if load else 0.0
    bose = noise.bose_psd_mk2_hz / noise.psd_mk2_hz if noise.psd_mk2_hz else 0.0
    return _shared(scene.photon.coherence, part, bose)


def _shared(coherence: str, part: float, bose: float | None) -> float:
    """Shared fraction of the photon noise, from the `part` of the load that is coherent between pixels, and the
    fraction `bose` of the noise that is bunching.
    """
    return part**2 * bose if coherence == "hbt" else part
