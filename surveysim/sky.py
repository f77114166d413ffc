"""Astronomical skies on a fine tangent-plane grid: a flat CMB band power and point sources."""

import numpy as np

from mapmaker.geometry import MapGeometry, pixel_centres, plane_directions, plane_offsets
from mapmaker.spectrum import mode_ell
from mapmaker.window import beam_window
from surveysim.sections import PointSource, Sky
from surveysim.units import rj_to_cmb


def flat_cmb_sky(
    geometry: MapGeometry,
    band_power_ukcmb2: float,
    frequency_hz: float,
    fwhm_rad: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """A Gaussian sky (n_y, n_x) float32 [mK RJ] of flat ``l(l+1) C_l / 2 pi``, seen by a Gaussian beam.

    Flat-sky synthesis, periodic in the grid, without a mean.
    """
    from scipy.fft import irfft2, rfft2

    n_y, n_x, pixel = geometry.n_y, geometry.n_x, geometry.pixel_rad
    ell = mode_ell(n_y, n_x, pixel)
    amplitude = np.sqrt(flat_spectrum_mk2(ell, band_power_ukcmb2, frequency_hz) * beam_window(ell, fwhm_rad))
    modes = rfft2(rng.standard_normal((n_y, n_x))) * (amplitude / pixel)
    return irfft2(modes, (n_y, n_x)).astype(np.float32)


def curved_cmb_sky(
    geometry: MapGeometry,
    band_power_ukcmb2: float,
    frequency_hz: float,
    fwhm_rad: float,
    nside: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """The same sky on the sphere by healpy, up to l = 2 nside, read off at the grid's pixel centres.

    For fields too large for a plane. healpy interpolates between pixels of `nside`.
    """
    import healpy

    lmax = 2 * nside
    degree, order = healpy.Alm.getlm(lmax)
    # healpy's own synthesis draws from numpy's global generator; these draws are keyed.
    deviates = rng.standard_normal((2, len(degree)))
    alm = np.where(order == 0, deviates[0], (deviates[0] + 1j * deviates[1]) / np.sqrt(2))
    ell = np.arange(lmax + 1.0)
    spectrum = np.sqrt(flat_spectrum_mk2(ell, band_power_ukcmb2, frequency_hz) * beam_window(ell, fwhm_rad))
    sphere = healpy.alm2map(healpy.almxfl(alm, spectrum), nside)
    ra, dec = plane_directions(geometry, *pixel_centres(geometry))
    return healpy.get_interp_val(sphere, np.pi / 2 - dec, ra).astype(np.float32)


def flat_spectrum_mk2(ell: np.ndarray, band_power_ukcmb2: float, frequency_hz: float) -> np.ndarray:
    """C_l [mK^2 sr, Rayleigh-Jeans] of a flat band power in uK_CMB^2; 0 at l = 0."""
    scale = 2 * np.pi * band_power_ukcmb2 * (1e-3 / rj_to_cmb(frequency_hz)) ** 2
    safe = np.where(ell > 0, ell * (ell + 1), np.inf)
    return scale / safe


def add_point_sources(
    sky_mk: np.ndarray, geometry: MapGeometry, sources: tuple[PointSource, ...], fwhm_rad: float
) -> np.ndarray:
    """The sky with Gaussian beams at the sources, (n_y, n_x) float32.

    Raises ValueError for a source that the tangent plane has no place for, 90 degrees or more from its centre.
    """
    xi, eta = pixel_centres(geometry)
    sigma = fwhm_rad / np.sqrt(8 * np.log(2))
    total = sky_mk.astype(float)
    for source in sources:
        x, y = plane_offsets(geometry, source.ra_rad, source.dec_rad)
        if not np.isfinite(x):
            raise ValueError(f"{source} is 90 degrees or more from the map's centre; nearer ones are expected")
        total += source.peak_mk * np.exp(-((xi - x) ** 2 + (eta - y) ** 2) / (2 * sigma**2))
    return total.astype(np.float32)


def central_source(geometry: MapGeometry, fwhm_rad: float) -> np.ndarray:
    """A sky (n_y, n_x) float32 of one point source of 1 mK in the middle of the grid."""
    xi, eta = pixel_centres(geometry)
    sigma = fwhm_rad / np.sqrt(8 * np.log(2))
    return np.exp(-(xi**2 + eta**2) / (2 * sigma**2)).astype(np.float32)


def draw_sky(section: Sky, geometry: MapGeometry, frequency_hz: float, fwhm_rad: float, rng) -> np.ndarray:
    """The sky of a scene (n_y, n_x) float32 [mK RJ], with the beam applied."""
    arguments = (geometry, section.cmb_band_power_ukcmb2, frequency_hz, fwhm_rad)
    if section.curved_nside is None:
        cmb = flat_cmb_sky(*arguments, rng)
    else:
        cmb = curved_cmb_sky(*arguments, section.curved_nside, rng)
    return add_point_sources(cmb, geometry, section.point_sources, fwhm_rad)
