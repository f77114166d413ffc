"""Astronomical skies on a fine tangent-plane grid: Gaussian skies of a spectrum, and point sources."""

from collections.abc import Callable
from functools import partial

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.geometry import MapGeometry, pixel_centres, plane_offsets
from mapmaker.spectrum import mode_ell
from mapmaker.transfer_function import beam_window
from surveysim.runtime.errors import OutOfRangeError
from surveysim.scene.passband import Passband
from surveysim.scene.sky import PointSource, Sky
from surveysim.scene.units import BOLTZMANN_J_K


def flat_cmb_sky(
    geometry: MapGeometry,
    band_power_ukcmb2: float,
    cmb_per_rj: float,
    fwhm_rad: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw a Gaussian sky of a flat band power ``l(l+1) C_l / 2 pi``, convolved with a Gaussian beam.

    Flat-sky synthesis: the sky is periodic in the grid and has no mean, so modes longer than the grid are missing.
    Their leakage through a taper is missing from an uncleaned map, by up to half of the power at the longest modes of
    the patch; scans no longer than the grid remove them anyway (`surveysim.reduction.scored_region.mapped_signal`).

    Parameters
    ----------
    cmb_per_rj
        Thermodynamic CMB temperature per Rayleigh-Jeans temperature in the band.

    Returns
    -------
    (n_y, n_x) float32 array [mK RJ]
    """
    of_ell = partial(flat_spectrum_mk2, band_power_ukcmb2=band_power_ukcmb2, cmb_per_rj=cmb_per_rj)
    return flat_sky(geometry, of_ell, fwhm_rad, rng)


def flat_sky(
    geometry: MapGeometry, spectrum_mk2: Callable[[np.ndarray], np.ndarray], fwhm_rad: float, rng: np.random.Generator
) -> np.ndarray:
    """Draw a sky of any spectrum C_l [mK^2 sr, Rayleigh-Jeans] of multipoles; else as `flat_cmb_sky`."""
    from scipy.fft import irfft2, rfft2

    n_y, n_x, pixel = geometry.n_y, geometry.n_x, geometry.pixel_rad
    ell = mode_ell(n_y, n_x, pixel)
    amplitude = np.sqrt(spectrum_mk2(ell) * beam_window(ell, fwhm_rad))
    modes = rfft2(rng.standard_normal((n_y, n_x))) * (amplitude / pixel)
    return irfft2(modes, (n_y, n_x)).astype(np.float32)


def curved_cmb_sky(
    geometry: MapGeometry,
    band_power_ukcmb2: float,
    cmb_per_rj: float,
    *,
    fwhm_rad: float,
    lmax: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw the same sky on the sphere up to l = `lmax`, at the pixel centres of the grid.

    For fields too large for a plane. The pole of the spherical harmonics is the centre of the field, where harmonics of
    high order vanish (`highest_order`), so a small field takes few of them. The accuracy of the non-uniform synthesis
    of ducc0 is 1e-6 of the rms.
    """
    of_ell = partial(flat_spectrum_mk2, band_power_ukcmb2=band_power_ukcmb2, cmb_per_rj=cmb_per_rj)
    return curved_sky(geometry, of_ell, fwhm_rad=fwhm_rad, lmax=lmax, rng=rng)


def curved_sky(
    geometry: MapGeometry,
    spectrum_mk2: Callable[[np.ndarray], np.ndarray],
    *,
    fwhm_rad: float,
    lmax: int,
    rng: np.random.Generator,
) -> np.ndarray:
    """Draw a sky of any spectrum C_l [mK^2 sr, Rayleigh-Jeans] of multipoles; else as `curved_cmb_sky`."""
    from ducc0.sht import synthesis_general

    mmax = highest_order(geometry, lmax)
    ell = np.arange(lmax + 1)
    spectrum = np.sqrt(spectrum_mk2(ell) * beam_window(ell, fwhm_rad))
    alm = np.concatenate([_coefficients(spectrum[m:], m, rng) for m in range(mmax + 1)])
    start = np.cumsum([0, *lmax + 1 - np.arange(mmax)]) - np.arange(mmax + 1)  # place of l = 0 of each order
    xi, eta = pixel_centres(geometry)
    place = np.stack([np.arctan(np.hypot(xi, eta)), np.arctan2(eta, xi) % (2 * np.pi)], axis=-1).reshape(-1, 2)
    order = {"spin": 0, "lmax": lmax, "mmax": mmax, "mstart": start.astype(np.uint64)}
    # One thread, so that no bit depends on the machine.
    sky = synthesis_general(alm=alm[None], loc=place, epsilon=1e-6, nthreads=1, **order)
    return sky.reshape(geometry.n_y, geometry.n_x).astype(np.float32)


def highest_order(geometry: MapGeometry, lmax: int) -> int:
    """Compute the order above which harmonics up to l = `lmax` vanish in the field, to 1e-6.

    At the distance r from the pole an order m decreases as a Bessel function of ``l sin(r)`` beyond its turning point
    m.
    """
    across = np.hypot(geometry.n_x, geometry.n_y) * geometry.pixel_rad / 2
    turning = lmax * np.sin(np.arctan(across))
    return min(lmax, int(np.ceil(turning + 6 * np.cbrt(turning) + 12)))


def _coefficients(spectrum: np.ndarray, order: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the harmonic coefficients of one order and all l >= order, from the square root of C_l."""
    if order == 0:
        return spectrum * (1 + 0j) * rng.standard_normal(len(spectrum))
    return spectrum * (rng.standard_normal(2 * len(spectrum)).view(complex) / np.sqrt(2))


def flat_spectrum_mk2(ell: np.ndarray, band_power_ukcmb2: float, cmb_per_rj: float) -> np.ndarray:
    """Compute C_l [mK^2 sr, Rayleigh-Jeans] of a flat band power in uK_CMB^2; 0 at l = 0."""
    return flat_spectrum_psd(ell) * (band_power_ukcmb2 * (1e-3 / cmb_per_rj) ** 2)


def add_point_sources(
    sky_mk: np.ndarray, geometry: MapGeometry, sources: tuple[PointSource, ...], fwhm_rad: float
) -> np.ndarray:
    """Add Gaussian beams at point sources to a sky; returns (n_y, n_x) float32 [mK RJ].

    Raises
    ------
    OutOfRangeError
        For a source 90 degrees or more from the centre of the tangent plane.
    """
    xi, eta = pixel_centres(geometry)
    sigma = fwhm_rad / np.sqrt(8 * np.log(2))
    total = sky_mk.astype(float)
    for source in sources:
        x, y = plane_offsets(geometry, source.ra_rad, source.dec_rad)
        if not np.isfinite(x):
            raise OutOfRangeError(f"{source} is 90 degrees or more from the map's centre; nearer ones are expected")
        total += source.peak_mk * np.exp(-((xi - x) ** 2 + (eta - y) ** 2) / (2 * sigma**2))
    return total.astype(np.float32)


def source_peak_mk(source: PointSource, band: Passband, effective_area_m2: float) -> float:
    """Peak Rayleigh-Jeans temperature [mK] of a point source in the beam, ``<S> A_eff / 2 k`` of a flux density S.

    The flux density is averaged over the passband. The effective area is the same at all its frequencies.
    """
    if source.peak_mk is not None:
        return source.peak_mk
    mean_jy = source.flux_jy * band.power_law(source.flux_frequency_hz, source.spectral_index)
    return 1e3 * 1e-26 * mean_jy * effective_area_m2 / (2 * BOLTZMANN_J_K)


def central_source(geometry: MapGeometry, fwhm_rad: float) -> np.ndarray:
    """Make a sky (n_y, n_x) float32 of one point source of 1 mK in the middle of the grid."""
    xi, eta = pixel_centres(geometry)
    sigma = fwhm_rad / np.sqrt(8 * np.log(2))
    return np.exp(-(xi**2 + eta**2) / (2 * sigma**2)).astype(np.float32)


def draw_sky(
    section: Sky,
    geometry: MapGeometry,
    cmb_per_rj: float,
    fwhm_rad: float,
    rng: np.random.Generator,
    *,
    fixed_mk: np.ndarray | None = None,
) -> np.ndarray:
    """Draw the beam-convolved sky of a scene, (n_y, n_x) float32 [mK RJ], sharpened for look-up by streams.

    `fixed_mk` (n_y, n_x) is the part of it that is neither random nor a point source, through the same beam.
    """
    sky = np.zeros((geometry.n_y, geometry.n_x), np.float32)
    if section.is_random:
        spectrum, lmax = partial(sky_spectrum_mk2, section, cmb_per_rj), section.curved_lmax
        if lmax is None:
            sky = flat_sky(geometry, spectrum, fwhm_rad, rng)
        else:
            sky = curved_sky(geometry, spectrum, fwhm_rad=fwhm_rad, lmax=lmax, rng=rng)
    if fixed_mk is not None:
        sky = sky + fixed_mk
    return sharpened(add_point_sources(sky, geometry, section.point_sources, fwhm_rad))


def sky_spectrum_mk2(section: Sky, cmb_per_rj: float, ell: np.ndarray) -> np.ndarray:
    """Compute C_l [mK^2 sr, Rayleigh-Jeans] of the random sky of a scene; 0 off the table of its spectrum."""
    if section.spectrum is None:
        return flat_spectrum_mk2(ell, section.cmb_band_power_ukcmb2, cmb_per_rj)
    return section.band_power_ukcmb2(ell) * flat_spectrum_mk2(ell, 1.0, cmb_per_rj)


def sharpened(sky_mk: np.ndarray) -> np.ndarray:
    """Compensate a sky (n_y, n_x) for the low-pass filter of bilinear look-up.

    Along each axis a look-up between cells has the transfer function ``sinc^2(x / 2 pi)``, with x the phase from cell
    to cell. The filter is its inverse up to x^4, ``1 + c / 6 + 2 c^2 / 45`` with c = 1 - cos x. For cells of half a map
    pixel its error in power is 0.1 % at half of the map's Nyquist multipole and 4 % at that multipole, where the
    look-up without it loses a third.
    """
    from scipy.ndimage import correlate1d

    once, twice = np.array([0, -0.5, 1, -0.5, 0]), np.array([0.25, -1, 1.5, -1, 0.25])
    taps = np.array([0, 0, 1, 0, 0]) + once / 6 + twice * (2 / 45)
    return correlate1d(correlate1d(sky_mk, taps, axis=0, mode="nearest"), taps, axis=1, mode="nearest")
