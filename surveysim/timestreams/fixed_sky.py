"""The part of a scene's sky that is given: maps, catalogues and clusters, averaged over the band."""

from pathlib import Path

import numpy as np

from mapmaker.geometry import MapGeometry
from surveysim.runtime.errors import InputError
from surveysim.scene.map_units import rj_mk_per_unit
from surveysim.scene.scene import Scene
from surveysim.scene.sky import SkyMap
from surveysim.scene.units import BOLTZMANN_J_K
from surveysim.telescope.diffraction import effective_area_m2
from surveysim.timestreams.map_projection import MARGIN, check_cost, map_on_grid, missing_cells
from surveysim.timestreams.sky_images import SkyImage, read_sky_image
from surveysim.timestreams.sky_sources import catalogue_mk, cluster_mk


def fixed_sky(scene: Scene, geometry: MapGeometry, fwhm_rad: tuple[float, ...]) -> np.ndarray | None:
    """Make the given sky of a scene through beams of some widths (n_beam,), (n_beam, n_y, n_x) [mK RJ].

    None for a scene without maps, catalogues and clusters.
    """
    section, band = scene.sky, scene.instrument.band
    parts = [map_mk(scene, item, geometry, fwhm_rad) for item in section.maps]
    flux_scale = peak_mk_per_jy(scene) * scene.instrument.beam_fwhm_rad**2
    parts += [catalogue_mk(item, geometry, fwhm_rad, band, flux_scale=flux_scale) for item in section.catalogues]
    parts += [cluster_mk(item, geometry, fwhm_rad, band) for item in section.clusters]
    return np.sum(parts, axis=0) if parts else None


def peak_mk_per_jy(scene: Scene) -> float:
    """Peak Rayleigh-Jeans temperature of a point source in the beam of the instrument over its flux [mK/Jy]."""
    return 1e3 * 1e-26 * effective_area_m2(scene) / (2 * BOLTZMANN_J_K)


def map_mk(scene: Scene, section: SkyMap, geometry: MapGeometry, fwhm_rad: tuple[float, ...]) -> np.ndarray:
    """Make the sky (n_beam, n_y, n_x) [mK RJ] of a map through beams of some widths (n_beam,)."""
    image = read_sky_image(section)
    scale = rj_mk_per_unit(
        image.unit,
        scene.instrument.band,
        frequency_hz=section.frequency_hz,
        spectral_index=section.spectral_index,
        own_fwhm_rad=image.fwhm_rad,
        beam_fwhm_rad=scene.instrument.beam_fwhm_rad,
        area_m2=effective_area_m2(scene),
    )
    return scale * map_on_grid(image, geometry, fwhm_rad)


def check_map(section: SkyMap, geometry: MapGeometry, fwhm_rad: tuple[float, ...]) -> None:
    """Raise InputError, with the key of the map, unless it holds the sky of a grid behind beams of some widths.

    For a map of which the file can't be read, with a beam wider than the camera's, too many pixels, and pixels without
    a value in the field of the scans.
    """
    image = read_sky_image(section)
    if image.fwhm_rad > min(fwhm_rad) * (1 + 1e-9):
        found, allowed = (np.degrees(width) * 3600 for width in (image.fwhm_rad, min(fwhm_rad)))
        raise InputError(
            f"beam_fwhm: {section.map_file}: found {found:.4g} arcsec; the camera's {allowed:.4g} arcsec or less is"
            " expected, as a map can't be sharpened"
        )
    check_cost(image, section.map_file, geometry, fwhm_rad)
    if section.missing == "refuse":
        _check_values(image, section.map_file, geometry, max(fwhm_rad))


def _check_values(image: SkyImage, path: Path, geometry: MapGeometry, fwhm_rad: float) -> None:
    off, empty, total = missing_cells(image, geometry, fwhm_rad)
    side = np.degrees(geometry.n_x * geometry.pixel_rad + 2 * MARGIN * fwhm_rad)
    field = f"the field of the scans and two beams around it, {side:.4g} deg wide"
    if off:
        raise InputError(
            f"map_file: {path}: found a map that lacks {off / total:.2g} of {field}; all of it is expected, or missing"
            " = 'zero'"
        )
    if empty:
        raise InputError(
            f"map_file: {path}: found pixels without a value (NaN) in {empty / total:.2g} of {field}; values are"
            " expected, or missing = 'zero'"
        )


def sky_notes(scene: Scene, beam_rad: float) -> list[str]:
    """Return lines on what is ignored of the files of a scene's sky, and on pixels that a beam is too narrow for."""
    found = []
    for number, section in enumerate(scene.sky.maps if scene.sky else ()):
        image = read_sky_image(section)
        notes = list(image.notes)
        if image.pixel_rad > beam_rad / 2 * (1 + 1e-3):
            pixel, beam = (np.degrees(width) * 3600 for width in (image.pixel_rad, beam_rad))
            notes.append(f"pixels of {pixel:.3g} arcsec are larger than half of the beam of {beam:.3g} arcsec")
        found += [f"sky.maps.{number}: {section.map_file.name}: {note}." for note in notes]
    return found
