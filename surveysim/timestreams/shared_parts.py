"""Correlations of the noise, strips of the layer and skies: parts that all observations of a scene share."""

import math
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from mapmaker.geometry import MapGeometry
from surveysim.atmosphere.layers import Layer, b2_factor, dominant_layer, layer_screen, layer_sections, wind_factor
from surveysim.runtime.errors import OutOfRangeError, SceneError
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.layers import Layer as LayerSection
from surveysim.scene.noise_and_sky import Photon
from surveysim.scene.scene import Scene
from surveysim.telescope.diffraction import effective_area_m2
from surveysim.telescope.focal_plane import Camera, CameraExtent
from surveysim.telescope.lattice_noise import LatticePixels, WaferPixels, embed
from surveysim.telescope.pixel_coherence import (
    MOST_DENSE,
    DensePixels,
    PixelCoherence,
    correlation_matrices,
    wave_noise_band,
)

if TYPE_CHECKING:
    from surveysim.atmosphere.thin_screen import Screen


def photon_coherence(cam: Camera, section: Photon, stop_emits: bool) -> PixelCoherence:
    """Make the correlation of photon noise against separation.

    Raises SceneError for a fraction of the stop with a beam that does not spill on it.
    """
    if section.coherence != "hbt":
        return PixelCoherence(section.coherence, cam.illumination)
    if section.stop_fraction and cam.illumination.efficiency == 1:
        raise SceneError(
            f"photon.stop_fraction: found {section.stop_fraction:g} with a beam that does not spill on the stop; 0, or "
            "an instrument.illumination beyond the edge of the stop, is expected"
        )
    return PixelCoherence(
        "hbt", cam.illumination, wave_noise_band(cam.band), with_stop=stop_emits and cam.illumination.efficiency < 1
    )


MOST_BETWEEN_WAFERS = 0.02  # largest correlation between wafers that is neglected, for many detectors


# Correlations differ in their last bits between numbers of BLAS threads; a run must not depend on the machine's cores.
@threadpool_limits.wrap(limits=1)
def shared_noise(cam: Camera, coherence: PixelCoherence, name: str) -> DensePixels | LatticePixels | WaferPixels | None:
    """Compute the correlation of a noise between pixels, by its parts; None where they share nothing."""
    if coherence.kind == "none":
        return None
    n_det = len(cam.focal_plane.x_rad)
    if n_det <= MOST_DENSE:
        angle = cam.polarization_angle_rad if coherence.kind == "hbt" else None
        return DensePixels(correlation_matrices(cam.positions_f_lambda, coherence, angle))
    if not cam.lattices:
        raise SceneError(
            f"{name}.coherence: found {coherence.kind!r} for the {n_det} detectors of a table; {MOST_DENSE} or fewer"
            " are expected, or an instrument.layout or wafers, whose lattices make noise that more share, or coherence"
            " 'none'"
        )
    _check_gap(cam, coherence, name)
    try:
        wafers = tuple(embed(lattice, cam.f_lambda_rad, coherence) for lattice in cam.lattices)
        return wafers[0] if len(wafers) == 1 else WaferPixels(wafers)
    except OutOfRangeError as error:
        raise SceneError(f"{name}.coherence: {error}") from None


def _check_gap(cam: Camera, coherence: PixelCoherence, name: str) -> None:
    """Raise SceneError for wafers so close that their detectors share more than `MOST_BETWEEN_WAFERS`."""
    gap = cam.gap_f_lambda
    if not gap < math.inf:
        return
    beyond = float(np.abs(coherence.parts(gap + np.linspace(0, 3, 301))).max())
    if beyond > MOST_BETWEEN_WAFERS:
        raise SceneError(
            f"{name}.coherence: found {coherence.kind!r} for more than {MOST_DENSE} detectors on wafers that are"
            f" {gap:.3g} (f/#)lambda apart, whose detectors share up to {beyond:.2g} of the noise;"
            f" {MOST_BETWEEN_WAFERS:g} or less is expected, as it is neglected: a larger gap, or coherence 'hbt' or"
            " 'none'"
        )


def screen(scene: Scene) -> "Screen":
    """Make the thin screen at the zenith of the layer with the largest share of B2.

    Raises SceneError for parameters that it has no closed form for.
    """
    return layer_screen(scene.atmosphere, dominant_layer(scene.atmosphere))


def air_layers(scene: Scene, extent: CameraExtent) -> tuple[Layer, ...]:
    """Make the layers with their caches of strips, still empty; none without turbulence."""
    if not scene.turbulent:
        return ()
    from surveysim.atmosphere.screen_simulation import SlantStrips

    air, numerics = scene.atmosphere, scene.numerics
    numbers = numerics.screen_step, numerics.interpolation, numerics.precision

    def layer(number: int, section: LayerSection) -> Layer:
        strips = SlantStrips(layer_screen(air, section), extent.radius_rad, extent.closest_rad, *numbers)
        return Layer(number, section, b2_factor(air, section), wind_factor(air, section), strips)

    return tuple(layer(*item) for item in enumerate(layer_sections(air)))


def scene_sky(scene: Scene, geometry: MapGeometry, fwhm_rad: tuple[float, ...]) -> np.ndarray | None:
    """Draw the sky of a scene through beams of some widths (n_beam,), (n_beam, n_y, n_x) [mK RJ]; None without one.

    The brightness of a point source is that in the beam of the instrument; its flux is the same in all beams.
    """
    if scene.sky is None:
        return None
    from surveysim.timestreams.fixed_sky import fixed_sky
    from surveysim.timestreams.sky_maps import draw_sky, source_peak_mk

    instrument, area_m2, skies = scene.instrument, effective_area_m2(scene), []
    fixed = fixed_sky(scene, geometry, fwhm_rad)
    for place, width in enumerate(fwhm_rad):
        rng, dilution = generator(scene.seed, RandomPurpose.SKY), _dilution(scene, width)
        sources = [
            item.model_copy(update={"peak_mk": source_peak_mk(item, instrument.band, area_m2) * dilution})
            for item in scene.sky.point_sources
        ]
        section = scene.sky.model_copy(update={"point_sources": tuple(sources)})
        here = None if fixed is None else fixed[place]
        skies.append(draw_sky(section, geometry, instrument.cmb_per_rj, width, rng, fixed_mk=here))
    return np.stack(skies)


def _dilution(scene: Scene, fwhm_rad: float) -> float:
    """Peak of a point source in a beam over that in the instrument's beam: the inverse ratio of their solid angles."""
    return (scene.instrument.beam_fwhm_rad / fwhm_rad) ** 2


def signal_skies(
    scene: Scene, geometry: MapGeometry, fwhm_rad: tuple[float, ...], *, own_mk: np.ndarray | None
) -> np.ndarray | None:
    """Draw the skies of the signal simulations through beams of some widths (n_beam,), (n_sky, n_beam, n_y, n_x).

    In mK RJ. After the random ones comes `own_mk` (n_beam, n_y, n_x), the scene's own sky, if there is one. The last is
    a point source where pipelines are compared. None without a score.
    """
    if scene.score is None:
        return None
    from surveysim.timestreams.sky_maps import central_source, flat_cmb_sky, flat_sky, sky_spectrum_mk2

    signal, cmb_per_rj = scene.score.signal_sims, scene.instrument.cmb_per_rj

    def sky(number: int, width: float) -> np.ndarray:
        rng = generator(scene.seed, RandomPurpose.SIGNAL_SIM, realization=number)
        if signal.spectrum == "sky":
            return flat_sky(geometry, partial(sky_spectrum_mk2, scene.sky, cmb_per_rj), width, rng)
        return flat_cmb_sky(geometry, signal.band_power_ukcmb2, cmb_per_rj, width, rng)

    skies = [np.stack([sky(number, width) for width in fwhm_rad]) for number in range(signal.skies)]
    if own_mk is not None:
        skies.append(own_mk)
    if scene.cleaning.compare:
        source = [central_source(geometry, width) * np.float32(_dilution(scene, width)) for width in fwhm_rad]
        skies.append(np.stack(source))
    return np.stack(skies)
