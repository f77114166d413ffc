"""Checks of a scene's sky against the field of its scans: maps, catalogues, clusters, point sources, spectrum."""

import math

import numpy as np

from mapmaker.geometry import MapGeometry, plane_offsets
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.scene import Scene
from surveysim.scene.sky import Sky


def check_contents(scene: Scene, grid: MapGeometry, fwhm_rad: tuple[float, ...]) -> None:
    """Raise SceneError for parts of the sky that the field of the scans, the sky `grid`, does not have.

    Parameters
    ----------
    fwhm_rad
        Different widths (n_beam,) of the beams.
    """
    if (sky := scene.sky) is None:
        return
    reach_rad = grid.n_x * grid.pixel_rad / 2 + 3 * scene.instrument.beam_fwhm_rad
    for number, source in enumerate(sky.point_sources):
        _check_place(f"sky.point_sources.{number}: found a source", grid, source.ra_rad, source.dec_rad, reach_rad)
    for number, cluster in enumerate(sky.clusters):
        _check_place(f"sky.clusters.{number}: found a cluster", grid, cluster.ra_rad, cluster.dec_rad, reach_rad)
    _check_catalogues(sky, grid, reach_rad)
    _check_maps(sky, grid, fwhm_rad)
    _check_spectrum(scene)


def _check_place(found: str, grid: MapGeometry, ra_rad: float, dec_rad: float, allowed_rad: float) -> None:
    offsets = plane_offsets(grid, ra_rad, dec_rad)
    # Written so that NaN, of a direction behind the plane, is refused.
    if not np.max(np.abs(offsets)) <= allowed_rad:
        distance = _separation(grid, ra_rad, dec_rad)
        raise SceneError(
            f"{found} {math.degrees(distance):.4g} deg from the field's centre, outside the map; one within"
            f" {math.degrees(allowed_rad):.4g} deg in right ascension and declination is expected"
        )


def _separation(grid: MapGeometry, ra_rad: float, dec_rad: float) -> float:
    """Angle [rad] of a direction from the centre of a map (haversine)."""
    across = math.cos(dec_rad) * math.cos(grid.dec0_rad) * math.sin((ra_rad - grid.ra0_rad) / 2) ** 2
    return 2 * math.asin(min(1.0, math.sqrt(math.sin((dec_rad - grid.dec0_rad) / 2) ** 2 + across)))


def _check_catalogues(sky: Sky, grid: MapGeometry, reach_rad: float) -> None:
    for number, section in enumerate(sky.catalogues):
        x, y = plane_offsets(grid, section.table.ra_rad, section.table.dec_rad)
        if not (np.maximum(np.abs(x), np.abs(y)) <= reach_rad).any():
            raise SceneError(
                f"sky.catalogues.{number}.catalogue_file: {section.catalogue_file}: found none of its {len(x)} sources"
                f" within {math.degrees(reach_rad):.4g} deg of the field's centre; one or more are expected there"
            )


def _check_maps(sky: Sky, grid: MapGeometry, fwhm_rad: tuple[float, ...]) -> None:
    if not sky.maps:
        return
    from surveysim.timestreams.fixed_sky import check_map

    for number, section in enumerate(sky.maps):
        try:
            check_map(section, grid, fwhm_rad)
        except InputError as error:
            raise SceneError(f"sky.maps.{number}.{error}") from None


def check_signal_spectrum(scene: Scene) -> None:
    """Raise SceneError for signal simulations of a sky that has no power at the scored multipoles."""
    if scene.score is None or scene.score.signal_sims.spectrum == "flat":
        return
    ell, known = np.arange(scene.score.ell_min, scene.score.ell_max + 1), scene.sky is not None
    if not (known and scene.sky.is_random and (scene.sky.band_power_ukcmb2(ell) > 0).all()):
        raise SceneError(
            "score.signal_sims.spectrum: found 'sky' without power of a random sky at all scored multipoles; 'flat' is"
            " expected, or sky.cmb_band_power or sky.spectrum above 0"
        )


def _check_spectrum(scene: Scene) -> None:
    """Raise SceneError for a spectrum that ends below the scored multipoles."""
    if scene.sky.spectrum is None or scene.score is None:
        return
    last = scene.sky.spectrum_table[0][-1]
    if last < scene.score.ell_max:
        raise SceneError(
            f"sky.spectrum: {scene.sky.spectrum}: found multipoles up to {last:g}; {scene.score.ell_max}"
            " (score.ell_max) or more are expected"
        )
