"""Correlations of the noise, strips of the layer and skies: parts that all observations of a scene share."""

import math
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.geometry import MapGeometry
from surveysim.runtime.errors import OutOfRangeError, SceneError
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.noise_and_sky import Excess, Photon
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera
from surveysim.telescope.lattice_noise import CirculantCorrelation, embed
from surveysim.telescope.layouts import HEXAGONAL
from surveysim.telescope.pixel_coherence import MOST_DENSE, DenseCorrelation, correlation_matrix, overlap

if TYPE_CHECKING:
    from surveysim.atmosphere.screen_simulation import SlantStrips
    from surveysim.atmosphere.thin_screen import Screen


# Eigenvectors of the correlations differ in their last bits, or in a degenerate space altogether, between
# numbers of BLAS threads; a run must not depend on the machine's cores.
@threadpool_limits.wrap(limits=1)
def shared_noise(
    cam: Camera, section: Photon | Excess | None, name: str
) -> DenseCorrelation | CirculantCorrelation | None:
    """Compute the correlation of a noise between overlapping pixels; None where they share nothing."""
    if section is None or section.coherence == "none":
        return None
    n_det = len(cam.focal_plane.x_rad)
    if n_det <= MOST_DENSE:
        return overlap(correlation_matrix(cam.positions_f_lambda, section.coherence, cam.illumination))
    if len(cam.lattices) != 1 or cam.lattices[0].cosine != HEXAGONAL:
        raise SceneError(
            f"{name}.coherence: found {section.coherence!r} for {n_det} detectors off a single hexagonal lattice; "
            f"{MOST_DENSE} or fewer are expected, or an instrument.layout, whose lattice makes noise that more share, "
            "or coherence 'none'"
        )
    try:
        lattice = cam.lattices[0]
        return embed(lattice.cells, lattice.pitch_rad / cam.f_lambda_rad, section.coherence, cam.illumination)
    except OutOfRangeError as error:
        raise SceneError(f"{name}.coherence: {error}") from None


def screen(scene: Scene) -> "Screen":
    """Make the thin screen at the zenith; raises SceneError for parameters that it has no closed form for."""
    from surveysim.atmosphere.thin_screen import Screen

    air = scene.atmosphere
    outer = math.inf if air.outer_scale_m is None else air.outer_scale_m / air.layer_height_m
    try:
        return Screen(air.spectral_index, air.illuminated_aperture_m / air.layer_height_m, outer)
    except OutOfRangeError as error:
        raise SceneError(f"atmosphere: {error}") from None


def layer_strips(scene: Scene, cam: Camera) -> "SlantStrips | None":
    """Make the cache of strips of the layer, still empty; None without an atmosphere."""
    if scene.atmosphere is None:
        return None
    from surveysim.atmosphere.screen_simulation import SlantStrips

    numerics = scene.numerics
    numbers = numerics.screen_step, numerics.interpolation, numerics.precision
    return SlantStrips(screen(scene), cam.radius_rad, cam.closest_rad, *numbers)


def scene_sky(scene: Scene, geometry: MapGeometry) -> np.ndarray | None:
    """Draw the sky (n_y, n_x) [mK RJ] of a scene; None without one."""
    if scene.sky is None:
        return None
    from surveysim.timestreams.sky_maps import draw_sky

    instrument = scene.instrument
    rng = generator(scene.seed, RandomPurpose.SKY)
    return draw_sky(scene.sky, geometry, instrument.cmb_per_rj, instrument.beam_fwhm_rad, rng)


def signal_skies(scene: Scene, geometry: MapGeometry) -> np.ndarray | None:
    """Draw the skies (n_sky, n_y, n_x) [mK RJ] of the signal simulations.

    The last is a point source where pipelines are compared. None without a score.
    """
    if scene.score is None:
        return None
    from surveysim.timestreams.sky_maps import central_source, flat_cmb_sky

    signal, instrument = scene.score.signal_sims, scene.instrument
    skies = [
        flat_cmb_sky(
            geometry,
            signal.band_power_ukcmb2,
            instrument.cmb_per_rj,
            instrument.beam_fwhm_rad,
            generator(scene.seed, RandomPurpose.SIGNAL_SIM, realization=sky),
        )
        for sky in range(signal.skies)
    ]
    if scene.cleaning.compare:
        skies.append(central_source(geometry, instrument.beam_fwhm_rad))
    return np.stack(skies)
