"""PSDs of the noise of a map, from the noise maps of its divisions."""

from dataclasses import dataclass

import numpy as np

from mapmaker.binning import BinnedMap
from mapmaker.errors import InsufficientDataError
from mapmaker.pipeline.maps import Maps
from mapmaker.spectrum import annuli, map_psd

_BINS = 24  # most bins of multipole
_SHALLOW = 0.02  # of the largest smoothed weight: below it the taper is 0


@dataclass(frozen=True)
class NoiseSpectra:
    """PSDs of noise maps, for the mean noise of the map of all data.

    The root of the weight makes the noise of a noise map even before its PSD is taken. Divisions that leave pixels with
    one half alone are then comparable with others.

    Attributes
    ----------
    edges_ell : (n_bin + 1,)
        Edges of the bins of multipole.
    ell : (n_bin,)
        Mean multipole of a bin.
    names
        Names of the divisions.
    psd_mk2 : (n_split, n_bin)
        [mK^2 sr].
    n_modes : (n_split, n_bin)
        Independent degrees of freedom.
    coverage : (n_split,)
        Fraction of the weight of the map in pixels that both halves have.
    """

    edges_ell: np.ndarray
    ell: np.ndarray
    names: tuple[str, ...]
    psd_mk2: np.ndarray
    n_modes: np.ndarray
    coverage: np.ndarray


def noise_spectra(maps: Maps, fwhm_rad: float) -> NoiseSpectra | None:
    """PSDs of all noise maps; None without a division that has two halves, or for a map of too few pixels."""
    geometry, item = maps.map.geometry, maps.map
    whole, taper = item.weight[0], coverage_taper(item, fwhm_rad)
    even = float(np.sum(taper**2) / np.sum(taper**2 / np.where(whole > 0, whole, 1.0)))
    edges, found = _edges(taper, geometry.pixel_rad), {}
    for split, item in zip(maps.splits, maps.noise, strict=True):
        weight = item.weight[0]
        # Pixels that one half lacks are left out.
        of_map = np.where(weight > 0, taper, 0.0)
        if not of_map.any():
            continue
        try:
            rings = annuli(geometry.n_y, geometry.n_x, geometry.pixel_rad, edges_ell=edges, taper=of_map)
        except InsufficientDataError:
            return None
        psd = map_psd(item.signal_mk[0] * np.sqrt(weight / even), of_map, geometry.pixel_rad, rings)
        found[split.name] = psd, rings.n_modes, weight.sum() / whole.sum()
        ell = rings.ell
    if not found:
        return None
    psd, n_modes, coverage = (np.array(rows) for rows in zip(*found.values(), strict=True))
    return NoiseSpectra(edges, ell, tuple(found), psd, n_modes, coverage)


def coverage_taper(item: BinnedMap, fwhm_rad: float) -> np.ndarray:
    """Taper (n_y, n_x) that weighs a map by its coverage: the weight smoothed with the beam, 1 at its largest.

    PSDs are then averages over the map with the square of the weight, to which noisy edges contribute little.
    """
    from scipy.ndimage import gaussian_filter

    sigma = max(1.0, fwhm_rad / np.sqrt(8 * np.log(2)) / item.geometry.pixel_rad)
    smooth = gaussian_filter(item.weight[0], sigma, mode="constant")
    smooth /= smooth.max()
    return np.where((item.weight[0] > 0) & (smooth > _SHALLOW), smooth, 0.0)


def _edges(taper: np.ndarray, pixel_rad: float) -> np.ndarray:
    """Edges of equal bins, from the extent of the coverage to that of a pixel."""
    extent = pixel_rad * np.sqrt(np.sum(taper > 0.5))
    least, most = 2 * np.pi / extent, np.pi / pixel_rad
    n = int(np.clip((most - least) / (2 * least), 1, _BINS))
    return np.linspace(least, most, n + 1)
