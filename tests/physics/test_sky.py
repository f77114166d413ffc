"""Skies against the spectrum they are drawn from.

A Fourier mode's power is exponential about the PSD (a real mode's is a squared normal), so the mean over
modes of N real degrees of freedom scatters by sqrt(2 / N); tolerances are 5 of these.
"""

import math

import numpy as np
import pytest

from mapmaker.geometry import MapGeometry, pixel_centres, plane_directions, wcs
from mapmaker.spectrum import annuli, map_psd, mode_ell, mode_psd
from mapmaker.window import beam_window
from surveysim.sections import PointSource, Sky
from surveysim.sky import (
    add_point_sources,
    curved_cmb_sky,
    draw_sky,
    flat_cmb_sky,
    flat_spectrum_mk2,
)
from surveysim.units import rj_to_cmb

ARCMIN = math.radians(1 / 60)
FREQUENCY, FWHM, BAND_POWER = 143e9, ARCMIN, 1000.0
GEOMETRY = MapGeometry(*np.radians([132.3, 44.84]), ARCMIN / 6, 384, 320)
DEGREE = math.radians(1.0)


def flat_skies(n, geometry=GEOMETRY, seed=1):
    rng = np.random.default_rng(seed)
    return np.stack([flat_cmb_sky(geometry, BAND_POWER, FREQUENCY, FWHM, rng) for _ in range(n)])


def expected_psd(ell):
    return flat_spectrum_mk2(ell, BAND_POWER, FREQUENCY) * beam_window(ell, FWHM)


def test_spectrum_is_a_flat_band_power():
    """l (l + 1) C_l / 2 pi in thermodynamic microkelvin."""
    ell = np.array([1.0, 10.0, 3000.0])
    c_ell = flat_spectrum_mk2(ell, BAND_POWER, FREQUENCY) * (1e3 * rj_to_cmb(FREQUENCY)) ** 2
    np.testing.assert_allclose(ell * (ell + 1) * c_ell / (2 * np.pi), BAND_POWER, rtol=1e-13)
    assert flat_spectrum_mk2(np.zeros(1), BAND_POWER, FREQUENCY)[0] == 0


def test_beam_is_the_transform_of_a_gaussian():
    """By the sum over a finely sampled beam of 60 arcsec at half maximum."""
    x = np.arange(-300, 301) * 1.5 * ARCMIN / 60
    beam = 0.5 ** ((2 * x / FWHM) ** 2)
    for ell in (0.0, 2000.0, 9000.0):
        # Trapezoids of a Gaussian converge exponentially; 450 arcsec are 17 sigma.
        assert np.sqrt(beam_window(np.array(ell), FWHM)) == pytest.approx(
            np.sum(beam * np.cos(ell * x)) / np.sum(beam), rel=1e-9
        )


def test_flat_sky_has_the_spectrum():
    """The grid is periodic: without a taper, modes are independent and nothing leaks."""
    n_sky = 4
    skies = flat_skies(n_sky)
    assert skies.shape == (n_sky, 320, 384) and skies.dtype == np.float32
    taper = np.ones((320, 384))
    edges = np.array([500, 1000, 2000, 4000, 8000, 12000, 15000, 18000.0])
    rings = annuli(320, 384, GEOMETRY.pixel_rad, edges, taper)
    psd = map_psd(skies, taper, GEOMETRY.pixel_rad, rings).mean(axis=0)
    ell = mode_ell(320, 384, GEOMETRY.pixel_rad).ravel()
    model = expected_psd(ell)
    for b in range(len(rings.ell)):
        modes = rings.bin_of_mode == b
        weight = rings.multiplicity[modes]
        expected = np.sum(weight * model[modes]) / weight.sum()
        # A steep spectrum has fewer effective modes: sum(w P)^2 / sum(w P^2).
        freedom = n_sky * np.sum(weight * model[modes]) ** 2 / np.sum(weight * model[modes] ** 2)
        assert psd[b] == pytest.approx(expected, rel=5 * math.sqrt(2 / freedom)), edges[b]


def test_power_of_single_modes():
    """Power over PSD of all modes up to l = 12000: mean 1, and as much scatter as complex normals have."""
    skies = flat_skies(24, seed=2)
    ell = mode_ell(320, 384, GEOMETRY.pixel_rad)
    inner = (ell > 0) & (ell < 12000)
    inner[:, 0] = False  # half of this column repeats the other
    ratio = mode_psd(skies, np.ones(skies.shape[1:]), GEOMETRY.pixel_rad)[:, inner] / expected_psd(ell[inner])
    assert ratio.mean() == pytest.approx(1, abs=5 / math.sqrt(ratio.size))
    # The variance of an exponential is 1, known to sqrt(8 / n).
    assert ratio.var() == pytest.approx(1, abs=5 * math.sqrt(8 / ratio.size))


def test_flat_sky_rms():
    """Sum of the PSD over all modes; a few large modes carry most, which the tolerance counts."""
    n_sky = 8
    skies = flat_skies(n_sky, seed=3)
    k = (
        2
        * np.pi
        * np.hypot(*np.meshgrid(np.fft.fftfreq(384, GEOMETRY.pixel_rad), np.fft.fftfreq(320, GEOMETRY.pixel_rad)))
    )
    power = expected_psd(k) / (384 * 320 * GEOMETRY.pixel_rad**2)
    relative = math.sqrt(2 * np.sum(power**2)) / np.sum(power)
    assert np.mean(skies.astype(float) ** 2) == pytest.approx(np.sum(power), rel=5 * relative / math.sqrt(n_sky))
    # No mean, but for the rounding of each pixel to single precision.
    assert np.abs(skies.mean(axis=(1, 2), dtype=float)).max() < np.finfo(np.float32).eps * np.abs(skies).max()


def test_same_seed_same_sky_and_no_global_state():
    np.random.seed(5)
    before = np.random.get_state()[1].copy()
    small = MapGeometry(2.3, 0.78, ARCMIN, 24, 20)

    def skies(seed):
        rng = np.random.default_rng(seed)
        curved = curved_cmb_sky(small, BAND_POWER, FREQUENCY, DEGREE, 32, rng)
        return flat_cmb_sky(small, BAND_POWER, FREQUENCY, FWHM, rng), curved

    for first, again, other in zip(skies(1), skies(1), skies(2), strict=True):
        assert first.shape == (20, 24) and first.dtype == np.float32
        np.testing.assert_array_equal(first, again)
        assert (first != other).mean() > 0.99
    np.testing.assert_array_equal(np.random.get_state()[1], before)


def test_pixel_centres_are_those_of_the_wcs():
    g = MapGeometry(*np.radians([132.3, 44.84]), ARCMIN, 11, 8)
    row, column = np.indices((8, 11))
    ra, dec = plane_directions(g, *pixel_centres(g))
    expected = wcs(g).wcs_pix2world(column.ravel(), row.ravel(), 0)
    np.testing.assert_allclose(np.degrees([ra.ravel(), dec.ravel()]), expected, rtol=1e-12)


def source(column, row, peak_mk):
    lon, lat = wcs(GEOMETRY).wcs_pix2world(column, row, 0)
    return PointSource.model_validate({"ra": f"{lon} deg", "dec": f"{lat} deg", "peak": f"{peak_mk} mK"})


def test_point_source_peak_width_and_flux():
    sky = add_point_sources(np.zeros((320, 384), np.float32), GEOMETRY, (source(100.0, 200.0, 5.0),), FWHM)
    assert sky.dtype == np.float32
    assert np.unravel_index(sky.argmax(), sky.shape) == (200, 100)
    single = float(np.finfo(np.float32).eps)
    assert sky[200, 100] == pytest.approx(5, rel=10 * single)
    # Half of the peak half a beam (3 pixels of 10 arcsec) away, on all sides.
    for row, column in ((200, 97), (200, 103), (197, 100), (203, 100)):
        assert sky[row, column] == pytest.approx(2.5, rel=1e-5)
    # A Gaussian's volume is peak * 2 pi sigma^2; its sum over 2.5 pixels a sigma is exact to 1e-50.
    volume = 5 * 2 * np.pi * FWHM**2 / (8 * math.log(2))
    assert sky.sum(dtype=float) * GEOMETRY.pixel_rad**2 == pytest.approx(volume, rel=1e-5)


def test_point_sources_add_to_the_sky():
    sky = flat_skies(1)[0]
    sources = (source(100.3, 200.8, 5.0), source(101.0, 198.0, -2.0))
    both = add_point_sources(sky, GEOMETRY, sources, FWHM)
    alone = [add_point_sources(np.zeros_like(sky), GEOMETRY, (one,), FWHM) for one in sources]
    np.testing.assert_allclose(both, sky + alone[0] + alone[1], atol=5e-6)
    y, x = np.indices(sky.shape)
    for item, column, row in ((alone[0], 100.3, 200.8), (alone[1], 101.0, 198.0)):
        assert np.sum(item * x) / item.sum() == pytest.approx(column, abs=1e-3)
        assert np.sum(item * y) / item.sum() == pytest.approx(row, abs=1e-3)


def test_sky_of_a_scene():
    """The drawn CMB with the sources on it; without band power, the sources alone."""
    sources = [{"ra": "132.3 deg", "dec": "44.84 deg", "peak": "5 mK"}]
    section = Sky.model_validate({"cmb_band_power": "1000 uK2", "point_sources": sources})
    drawn = draw_sky(section, GEOMETRY, FREQUENCY, FWHM, np.random.default_rng(1))
    expected = add_point_sources(flat_skies(1)[0], GEOMETRY, section.point_sources, FWHM)
    np.testing.assert_array_equal(drawn, expected)
    dark = Sky.model_validate({"cmb_band_power": "0 uK2", "point_sources": sources})
    alone = draw_sky(dark, GEOMETRY, FREQUENCY, FWHM, np.random.default_rng(1))
    np.testing.assert_allclose(
        alone, add_point_sources(np.zeros_like(drawn), GEOMETRY, section.point_sources, FWHM), atol=1e-7
    )
    curved = Sky.model_validate({"cmb_band_power": "1000 uK2", "curved_nside": 64})
    sphere = draw_sky(curved, GEOMETRY, FREQUENCY, DEGREE, np.random.default_rng(1))
    again = curved_cmb_sky(GEOMETRY, BAND_POWER, FREQUENCY, DEGREE, 64, np.random.default_rng(1))
    np.testing.assert_array_equal(sphere, again)


NSIDE, N_SKY = 256, 40


def expected_tapered_psd(geometry, taper, fwhm_rad):
    """Mean PSD of a tapered map on the half plane, by the sky's correlation function, lag by lag."""
    ell = np.arange(2 * NSIDE + 1)
    spectrum = flat_spectrum_mk2(ell, BAND_POWER, FREQUENCY) * beam_window(ell, fwhm_rad)
    angle = np.linspace(0, 30 * DEGREE, 3000)
    correlation = np.polynomial.legendre.legval(np.cos(angle), (2 * ell + 1) / (4 * np.pi) * spectrum)
    n = len(taper)
    padded = np.pad(taper, (0, n))
    autocorrelation = np.fft.irfft2(np.abs(np.fft.rfft2(padded)) ** 2, padded.shape)
    lag = np.fft.fftfreq(2 * n, 1 / (2 * n))
    distance = np.hypot(lag[:, None], lag) * geometry.pixel_rad
    # Every second mode of the padded grid is one of the map's.
    power = np.fft.rfft2(autocorrelation * np.interp(distance, angle, correlation)).real[::2, ::2]
    return power * geometry.pixel_rad**2 / np.sum(taper**2)


def test_curved_sky_has_the_spectrum():
    """On a field of 19 degrees, below l = 150.

    Interpolation between pixels of theta = 0.23 degrees takes (l theta)^2 / 6 of the power of a bilinear grid
    of them, up to 6 % at l = 150; half of that is allowed for the sphere's own arrangement of pixels. The
    tangent plane's stretch at 9.6 degrees from the centre is 2.8 %, 1 % on average under the taper.
    """
    fwhm = 0.6 * DEGREE
    geometry = MapGeometry(*np.radians([132.3, -15.0]), 0.3 * DEGREE, 64, 64)
    rng = np.random.default_rng(4)
    skies = np.stack([curved_cmb_sky(geometry, BAND_POWER, FREQUENCY, fwhm, NSIDE, rng) for _ in range(N_SKY)])
    taper = np.outer(np.hanning(66)[1:-1], np.hanning(66)[1:-1])
    edges = np.array([30, 75, 150.0])
    rings = annuli(64, 64, geometry.pixel_rad, edges, taper)
    psd = map_psd(skies, taper, geometry.pixel_rad, rings).mean(axis=0)
    model = expected_tapered_psd(geometry, taper, fwhm).ravel()
    theta = math.sqrt(4 * np.pi / 12) / NSIDE
    for b, ell in enumerate(rings.ell):
        modes = rings.bin_of_mode == b
        weight = rings.multiplicity[modes]
        expected = np.sum(weight * model[modes]) / weight.sum()
        lost = (ell * theta) ** 2 / 6
        tolerance = 5 * math.sqrt(2 / (N_SKY * rings.n_modes[b])) + 0.5 * lost + 0.02
        assert psd[b] == pytest.approx(expected * (1 - lost), rel=tolerance), ell


class OneMode:
    """Stands for a generator: all deviates 0 but the real part of one mode."""

    def __init__(self, nside, ell, m):
        import healpy

        self.index = healpy.Alm.getidx(2 * nside, ell, m)

    def standard_normal(self, shape):
        deviates = np.zeros(shape)
        deviates[0, self.index] = 1
        return deviates


def test_curved_sky_lies_where_the_grid_looks():
    """Single harmonics of l = 1: along the pole sin(dec), along RA 0 cos(dec) cos(ra)."""
    nside, fwhm = 64, 4 * DEGREE
    g = MapGeometry(*np.radians([132.3, -15.0]), DEGREE, 20, 16)
    ra, dec = plane_directions(g, *pixel_centres(g))
    amplitude = math.sqrt(flat_spectrum_mk2(np.array(1.0), BAND_POWER, FREQUENCY)) * np.sqrt(beam_window(1.0, fwhm))
    # Y_10 = sqrt(3 / 4 pi) cos(theta); a_11 = 1 / sqrt(2) and its conjugate give sqrt(2) Re Y_11.
    shapes = {0: np.sin(dec), 1: -np.cos(dec) * np.cos(ra)}
    for m, shape in shapes.items():
        sky = curved_cmb_sky(g, BAND_POWER, FREQUENCY, fwhm, nside, OneMode(nside, 1, m))
        # Linear interpolation over theta = 0.9 degrees: theta^2 / 8 of the amplitude, 3e-5, an axis.
        np.testing.assert_allclose(sky / (amplitude * math.sqrt(3 / (4 * np.pi))), shape, atol=1e-4)


def test_curved_sky_has_the_variance():
    """Sum of (2 l + 1) C_l / 4 pi, seen in 12 columns of 40 degrees around the equator and beside both poles.

    The mean square over points has the variance 2 <C_ij^2>, the mean over all pairs of points.
    """
    nside, fwhm, n_sky = 64, 4 * DEGREE, 6
    ell = np.arange(2 * nside + 1)
    power = flat_spectrum_mk2(ell, BAND_POWER, FREQUENCY) * beam_window(ell, fwhm)
    right_ascensions = np.arange(12) * np.pi / 6
    fields = [MapGeometry(ra, dec, 2 * DEGREE, 1, 21) for ra in right_ascensions for dec in (-0.9, 0, 0.9)]
    variance = np.mean(
        [
            np.square(
                curved_cmb_sky(g, BAND_POWER, FREQUENCY, fwhm, nside, np.random.default_rng(seed)),
                dtype=float,
            )
            for seed in range(n_sky)
            for g in fields
        ]
    )
    ra, dec = np.concatenate([np.reshape(plane_directions(g, *pixel_centres(g)), (2, -1)) for g in fields], axis=1)
    points = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    covariance = np.polynomial.legendre.legval(points.T @ points, (2 * ell + 1) / (4 * np.pi) * power)
    expected = np.sum((2 * ell + 1) * power) / (4 * np.pi)
    spread = math.sqrt(2 * np.mean(covariance**2) / n_sky)
    # Interpolation over theta = 0.9 degrees takes (l theta)^2 / 6: 0.6 % of what the beam leaves.
    assert variance == pytest.approx(expected, abs=5 * spread + 0.01 * expected)
    assert 5 * spread < 0.5 * expected
