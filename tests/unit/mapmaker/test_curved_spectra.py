"""Coupling on the sphere against 3-j symbols, the plane and skies."""

from functools import partial

import numpy as np
import pytest
from healpy import alm2map, anafast, pix2vec, synalm
from scipy.special import eval_legendre

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.cross_spectra import cross_band_powers, realized_band_powers
from mapmaker.curved_spectra import curved_coupling, healpix_window
from mapmaker.errors import InsufficientDataError, OutOfRangeError
from mapmaker.flat_spectra import flat_coupling
from mapmaker.spectrum import tukey
from mapmaker.transfer_function import beam_window
from tests import naive

NSIDE = 16
ELL = np.arange(3.0 * NSIDE)
EDGES = np.array([2.0, 6, 12, 20, 32])
BEAM = partial(beam_window, fwhm_rad=np.radians(8))


def cap(nside, tilt=0.2):
    """Taper of a third of the sky, not symmetric."""
    x, _, z = pix2vec(nside, np.arange(12 * nside**2))
    return np.clip(z - 0.3, 0, None) ** 0.7 * (1 + tilt * x)


def test_coupling_is_the_sum_over_3j_symbols():
    taper = cap(NSIDE)
    found = curved_coupling(taper, edges_ell=EDGES, beam=BEAM)
    modes = 2 * ELL + 1
    inside = (EDGES[:-1, None] <= ELL) & (EDGES[1:, None] > ELL)
    mean = inside * modes / np.sum(inside * modes, axis=1, keepdims=True)
    matrix, squared = (naive.coupling_on_sphere(anafast(taper**n, lmax=47), 48) for n in (1, 2))
    response = mean @ matrix * modes / np.mean(taper**2) * BEAM(ELL) * healpix_window(ELL, NSIDE)
    np.testing.assert_allclose(found.response, response * flat_spectrum_psd(ELL), rtol=1e-8, atol=1e-20)
    scatter = mean @ squared @ mean.T / np.mean(taper**2) ** 2
    np.testing.assert_allclose(found.scatter, scatter, rtol=1e-8)
    np.testing.assert_allclose(found.windows.sum(axis=1), 1, rtol=1e-10)
    np.testing.assert_allclose(found.ell, mean @ ELL)


def test_whole_sky_couples_nothing():
    found = curved_coupling(np.ones(12 * NSIDE**2), edges_ell=EDGES, beam=BEAM)
    inside = (EDGES[:-1, None] <= ELL) & (EDGES[1:, None] > ELL)
    assert (np.abs(found.response[~inside]) < 1e-8 * found.response.max()).all()
    np.testing.assert_allclose(found.n_modes, inside @ (2 * ELL + 1), rtol=1e-4)


def test_skies_come_back():
    """60 skies in two maps, behind beam and taper."""
    taper, n_sky, rng = cap(NSIDE), 60, np.random.default_rng(1)
    found = curved_coupling(taper, edges_ell=EDGES, beam=BEAM)
    spectrum = 100 * (1 + 20 / (ELL + 10))
    np.random.seed(2)  # healpy's only way
    power = spectrum * flat_spectrum_psd(ELL) * BEAM(ELL) * healpix_window(ELL, NSIDE)
    skies = np.array([alm2map(synalm(power, lmax=47), NSIDE, lmax=47) for _ in range(n_sky)])
    maps = skies[:, None] + rng.normal(size=(n_sky, 2, taper.size)) * np.array([2.0, 4])[:, None]
    realized = realized_band_powers(maps, found)
    expected, error = found.windows @ spectrum[found.window_ell.astype(int)], realized.std(axis=0) / np.sqrt(n_sky)
    assert (np.abs(realized.mean(axis=0) - expected) < 4 * error).all()
    analytic = cross_band_powers(maps[0], found, signal_uk2=expected).covariance
    assert analytic.flags == ()
    np.testing.assert_allclose(found.field.unevenness(maps[0, 0] - maps[0, 1])[1:], 1, atol=0.5)
    assert (np.abs(analytic.error_uk2 / realized.std(axis=0) - 1) < 4 / np.sqrt(2 * n_sky)).all()


def test_a_small_field_is_flat():
    """A square of 32 degrees on the equator: the same taper on the sphere and on a plane of equal area."""
    nside, side, edges = 128, np.radians(32), np.arange(40.0, 201, 40)
    x, y, z = pix2vec(nside, np.arange(12 * nside**2))
    at = np.arctan2(y, x), z  # equal area
    pixel = np.radians(0.5)
    along = (np.arange(64) - 31.5) * pixel
    profile = tukey(64, pixel, side, 1.0)
    taper = np.prod([np.interp(a, along, profile, left=0, right=0) for a in at], axis=0)
    curved = curved_coupling(taper, edges_ell=edges, beam=np.ones_like)
    flat = flat_coupling(np.outer(profile, profile), pixel, edges_ell=edges, beam=np.ones_like)
    assert curved.resolution_ell == pytest.approx(flat.resolution_ell, rel=0.01)
    np.testing.assert_allclose(curved.n_modes, flat.n_modes, rtol=0.05)
    ratio = [np.diag(item.matrix) / flat_spectrum_psd(item.ell) for item in (curved, flat)]
    windows = [healpix_window(curved.ell, nside), np.sinc(flat.ell * pixel / 2 / np.pi) ** 2]
    np.testing.assert_allclose(ratio[0] / windows[0], ratio[1] / windows[1], rtol=0.03)


def test_window_of_pixels():
    """Mean of P_l over pairs of 256 points in every 17th pixel; squares differ by 2 % at 2 nside."""
    nside, finer, ell = 8, 16, np.array([8, 16])
    found = []
    for pixel in range(0, 12 * nside**2, 17):
        inside = np.array(pix2vec(nside * finer, pixel * finer**2 + np.arange(finer**2), nest=True))
        found.append([eval_legendre(l_, np.clip(inside.T @ inside, -1, 1)).mean() for l_ in ell])
    np.testing.assert_allclose(healpix_window(ell.astype(float), nside), np.mean(found, axis=0), rtol=3e-3)


def test_refusals():
    taper = cap(NSIDE)
    with pytest.raises(ValueError, match="taper: found 100 values; 12 nside.2, a whole sky of HEALPix pixels, are"):
        curved_coupling(np.ones(100), edges_ell=EDGES, beam=BEAM)
    with pytest.raises(OutOfRangeError, match="edges_ell: found 40; at most 32, twice nside, is expected"):
        curved_coupling(taper, edges_ell=np.array([2.0, 40]), beam=BEAM)
    with pytest.raises(InsufficientDataError, match="no multipole has 2.2 <= ell < 2.8"):
        curved_coupling(taper, edges_ell=np.array([2.2, 2.8, 5]), beam=BEAM)
