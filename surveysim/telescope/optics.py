"""Radiative chain of a scene: sky, optical elements, stop and detector, from [optics] or from [photon.load]."""

import math
from functools import lru_cache

import numpy as np

from surveysim.atmosphere.opacity import BandOpacity, optical_depth, spectral_depth
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.instrument import Instrument
from surveysim.scene.noise_and_sky import OpticalLoad
from surveysim.scene.optics import Optics
from surveysim.scene.scene import Scene
from surveysim.scene.units import CMB_TEMPERATURE_K
from surveysim.telescope.focal_plane import stop_share, total_efficiency
from surveysim.telescope.radiative_chain import (
    DETECTOR,
    SKY,
    STOP,
    RadiativeChain,
    Surface,
    black_body,
    coupling,
    emitter,
    stated,
)

LEAST_TRANSMISSION = 1e-6  # of an element: nothing is measured through an opaque one


def scene_chain(scene: Scene, opacity: BandOpacity | None, pwv_mm: float, elevation_rad: float) -> RadiativeChain:
    """Make the radiative chain of a scene that gives noise by power.

    Without [optics] and [photon.load] it is the coupling of the detector alone.

    Parameters
    ----------
    opacity
        Opacity of the site in the band; None without a site.
    pwv_mm
        Precipitable water of the observation.
    elevation_rad
        Mean elevation of the observation.

    Raises
    ------
    SceneError
        For a table of an element that does not cover the band, and for an opaque element.
    """
    band, load = scene.instrument.band, scene.photon.load if scene.photon else None
    if scene.optics is not None:
        sky = _sky(scene.optics, opacity, pwv_mm, elevation_rad, band.nodes[0])
        surfaces = (*sky, *_optics(scene.optics, scene.instrument))
    elif load is not None:
        surfaces = (*_load(load, opacity, pwv_mm, elevation_rad, band.nodes[0]), _simple_coupling(scene.instrument))
    else:
        surfaces = (_simple_coupling(scene.instrument),)
    return RadiativeChain(band, scene.instrument.polarizations, surfaces)


def _sky(
    optics: Optics, opacity: BandOpacity | None, pwv_mm: float, elevation_rad: float, frequency_hz: np.ndarray
) -> tuple[Surface, ...]:
    """Surfaces before the first element: a stated sky, or CMB and atmosphere."""
    if optics.sky_k is not None:
        return (stated("sky", SKY, optics.sky_k, frequency_hz),)
    emitted = black_body(frequency_hz, CMB_TEMPERATURE_K)
    cmb = Surface("CMB", SKY, CMB_TEMPERATURE_K, emitted, np.ones(frequency_hz.shape))
    if opacity is None:
        return (cmb,)
    passed = np.exp(-spectral_depth(opacity, pwv_mm) / np.sin(elevation_rad))
    return cmb, emitter("atmosphere", SKY, opacity.temperature_k, frequency_hz, transmission=passed)


@lru_cache(maxsize=16)  # all observations have the same
def _optics(optics: Optics, instrument: Instrument) -> tuple[Surface, ...]:
    """Surfaces from the first element to the absorber."""
    frequency_hz = instrument.band.nodes[0]
    found: list[Surface] = []
    for element in optics.elements:
        try:
            passed, emitted = element.losses(frequency_hz)
        except InputError as error:
            raise SceneError(f"optics.elements: {element.name!r}: {error}") from None
        loss = {"transmission": passed, "emissivity": emitted}
        found.append(emitter(element.name, element.side, element.temperature_k, frequency_hz, **loss))
        if passed.max() < LEAST_TRANSMISSION:
            raise SceneError(
                f"optics.elements: {element.name!r}: found a transmission of {passed.max():g}; {LEAST_TRANSMISSION:g} "
                "or more somewhere in the band is expected"
            )
    share = stop_share(instrument, frequency_hz)
    if optics.stop is None and share.min() < 1:
        raise SceneError(
            f"optics.stop: missing; {1 - share.mean():.2f} of each pixel's beam spills on it and sees its temperature"
        )
    if optics.stop is not None:
        place = sum(surface.side == SKY for surface in found)
        found.insert(place, emitter("stop", STOP, optics.stop.temperature_k, frequency_hz, transmission=share))
    return *found, coupling(frequency_hz, instrument.efficiency)


def _load(
    load: OpticalLoad, opacity: BandOpacity | None, pwv_mm: float, elevation_rad: float, frequency_hz: np.ndarray
) -> tuple[Surface, Surface]:
    """Sky and warm optics of a stated load, in Rayleigh-Jeans temperature.

    A stated sky is in temperatures calibrated above the atmosphere, as in the paper. That of a site is a black body in
    the Rayleigh-Jeans limit, with the mean transmission of the band at the airmass.
    """
    passed, sky_k = 1.0, load.sky_k
    if sky_k is None:
        passed = float(np.exp(-optical_depth(opacity, pwv_mm, airmass=1 / math.sin(elevation_rad))))
        sky_k = opacity.temperature_k * (1 - passed)
    sky = stated("sky", SKY, sky_k, frequency_hz, passed)
    return sky, stated("warm optics", DETECTOR, load.optics_k, frequency_hz)


def site_load_k(opacity: BandOpacity, pwv_mm: float, elevation_rad: np.ndarray) -> np.ndarray:
    """Load (n,) [K] of the air above a site at some elevations, a black body in the Rayleigh-Jeans limit."""
    depth = [float(optical_depth(opacity, pwv_mm, airmass=1 / math.sin(item))) for item in elevation_rad.tolist()]
    return opacity.temperature_k * (1 - np.exp(-np.array(depth)))


def _simple_coupling(instrument: Instrument) -> Surface:
    return coupling(instrument.band.nodes[0], total_efficiency(instrument))
