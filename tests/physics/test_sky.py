"""Skies against the spectrum they are drawn from.

A Fourier mode's power is exponential about the PSD (a real mode's is a squared normal), so the mean over
modes of N real degrees of freedom scatters by sqrt(2 / N); tolerances are 5 of these.
"""

import math

import numpy as np
import pytest
from scipy.special import eval_legendre

from mapmaker.geometry import MapGeometry, pixel_centres, plane_directions, wcs
from mapmaker.kernels.pixels import add_skies
from mapmaker.spectrum import annuli, coupled_psd, map_psd, mode_ell, mode_psd, ring_mean, tukey_taper
from mapmaker.transfer_function import beam_window
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.passband import top_hat
from surveysim.scene.scene import load_scene
from surveysim.scene.sky import PointSource, Sky
from surveysim.telescope.diffraction import effective_area_m2
from surveysim.timestreams.sky_maps import (
    add_point_sources,
    curved_cmb_sky,
    draw_sky,
    flat_cmb_sky,
    flat_spectrum_mk2,
    highest_order,
    sharpened,
    source_peak_mk,
)
from tests.scenes import SMALL_SCENE, without_sections, write_scene

ARCMIN = math.radians(1 / 60)
CMB_PER_RJ, FWHM, BAND_POWER = top_hat(143e9, 0.15).cmb_per_rj, ARCMIN, 1000.0
GEOMETRY = MapGeometry(*np.radians([132.3, 44.84]), ARCMIN / 6, 384, 320)
DEGREE = math.radians(1.0)


def flat_skies(n, geometry=GEOMETRY, seed=1):
    rng = np.random.default_rng(seed)
    return np.stack([flat_cmb_sky(geometry, BAND_POWER, CMB_PER_RJ, FWHM, rng) for _ in range(n)])


def expected_psd(ell):
    return flat_spectrum_mk2(ell, BAND_POWER, CMB_PER_RJ) * beam_window(ell, FWHM)


def test_spectrum_is_a_flat_band_power():
    """l (l + 1) C_l / 2 pi in thermodynamic microkelvin."""
    ell = np.array([1.0, 10.0, 3000.0])
    c_ell = flat_spectrum_mk2(ell, BAND_POWER, CMB_PER_RJ) * (1e3 * CMB_PER_RJ) ** 2
    np.testing.assert_allclose(ell * (ell + 1) * c_ell / (2 * np.pi), BAND_POWER, rtol=1e-13)
    assert flat_spectrum_mk2(np.zeros(1), BAND_POWER, CMB_PER_RJ)[0] == 0


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
    rings = annuli(320, 384, GEOMETRY.pixel_rad, edges_ell=edges, taper=taper)
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
        curved = curved_cmb_sky(small, BAND_POWER, CMB_PER_RJ, fwhm_rad=DEGREE, lmax=64, rng=rng)
        return flat_cmb_sky(small, BAND_POWER, CMB_PER_RJ, FWHM, rng), curved

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
    drawn = draw_sky(section, GEOMETRY, CMB_PER_RJ, FWHM, np.random.default_rng(1))
    expected = add_point_sources(flat_skies(1)[0], GEOMETRY, section.point_sources, FWHM)
    np.testing.assert_array_equal(drawn, sharpened(expected))
    dark = Sky.model_validate({"cmb_band_power": "0 uK2", "point_sources": sources})
    alone = draw_sky(dark, GEOMETRY, CMB_PER_RJ, FWHM, np.random.default_rng(1))
    np.testing.assert_allclose(
        alone, sharpened(add_point_sources(np.zeros_like(drawn), GEOMETRY, section.point_sources, FWHM)), atol=1e-7
    )
    curved = Sky.model_validate({"cmb_band_power": "1000 uK2", "curved_lmax": 128})
    sphere = draw_sky(curved, GEOMETRY, CMB_PER_RJ, DEGREE, np.random.default_rng(1))
    again = curved_cmb_sky(GEOMETRY, BAND_POWER, CMB_PER_RJ, fwhm_rad=DEGREE, lmax=128, rng=np.random.default_rng(1))
    np.testing.assert_array_equal(sphere, sharpened(again))


@pytest.mark.parametrize(("phase", "allowed"), [(0.3, 1e-4), (0.6, 2e-4), (np.pi / 4, 1e-3), (np.pi / 2, 0.04)])
def test_looked_up_waves_keep_their_power(phase, allowed):
    """Waves with a phase from cell to cell, along one axis and oblique, read at random places through `add_skies`.

    Their power is the square of the projection of what is read on the wave itself; without sharpening, a wave at the
    map's Nyquist multipole (half pi) loses a third of it. Per axis, so the oblique wave loses twice as much.
    """
    n, n_samp = 128, 200_000
    row, column = np.indices((n, n))
    rng = np.random.default_rng(6)
    at_column, at_row = rng.uniform(8, n - 9, (2, n_samp))
    for across in (0.0, phase):
        sky = np.exp(1j * (phase * column + across * row))
        read = np.zeros((2, 1, n_samp))
        for part, of_sky in enumerate((sky.real, sky.imag)):
            place = np.zeros((8, n_samp))
            place[0], place[3] = at_column, at_row
            add_skies(read[part : part + 1], sharpened(of_sky)[None], place, np.zeros(1), np.zeros(1), np.ones(1))
        wave = np.exp(-1j * (phase * at_column + across * at_row))
        power = np.abs(np.mean((read[0, 0] + 1j * read[1, 0]) * wave)) ** 2
        # Random places add the images of the grid, of a few percent of the amplitude each.
        assert power == pytest.approx(1, abs=2 * allowed + 6 * 0.2 * phase**2 / np.sqrt(n_samp))


# ---------------------------------------------------------------- on the sphere


class OneDeviate:
    """Stands for a generator: all deviates 0 but the one of this number, in the order in which they are drawn."""

    def __init__(self, number):
        self.number, self.drawn = number, 0

    def standard_normal(self, size):
        deviates = np.zeros(size)
        if 0 <= self.number - self.drawn < size:
            deviates[self.number - self.drawn] = 1
        self.drawn += size
        return deviates


def sphere_covariance(cosine, lmax, fwhm_rad):
    """Sum of (2 l + 1) C_l P_l / 4 pi."""
    ell = np.arange(lmax + 1)
    power = flat_spectrum_mk2(ell, BAND_POWER, CMB_PER_RJ) * beam_window(ell, fwhm_rad)
    return np.polynomial.legendre.legval(cosine, (2 * ell + 1) / (4 * np.pi) * power)


@pytest.mark.parametrize("dec", [-15.0, 89.0])
def test_curved_sky_has_the_covariance_of_the_sphere(dec):
    """Between all pixels of a grid of 80 degrees, exactly: a sky is linear in its deviates, so their responses give it.

    Angles between pixels are those of their right ascensions and declinations. The synthesis is right to 1e-6, single
    precision to 6e-8.
    """
    lmax, fwhm = 20, 6 * DEGREE
    g = MapGeometry(*np.radians([132.3, dec]), 20 * DEGREE, 5, 4)
    assert highest_order(g, lmax) == lmax
    responses = np.array(
        [
            curved_cmb_sky(g, BAND_POWER, CMB_PER_RJ, fwhm_rad=fwhm, lmax=lmax, rng=OneDeviate(j)).ravel()
            for j in range((lmax + 1) ** 2)
        ]
    ).astype(float)
    ra, dec = (item.ravel() for item in plane_directions(g, *pixel_centres(g)))
    points = np.array([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)])
    expected = sphere_covariance(points.T @ points, lmax, fwhm)
    np.testing.assert_allclose(responses.T @ responses, expected, atol=1e-5 * expected.max())


@pytest.mark.parametrize(("pixel_arcmin", "lmax"), [(0.5, 4000), (10.0, 700), (60.0, 150)])
def test_orders_that_are_left_out_do_not_reach_the_field(monkeypatch, pixel_arcmin, lmax):
    """Fields of 0.7, 13 and 80 degrees across corners: those above `highest_order` change a millionth of the rms."""
    g = MapGeometry(2.3, 0.78, pixel_arcmin * ARCMIN, 60, 50)

    def sky():
        return curved_cmb_sky(g, BAND_POWER, CMB_PER_RJ, fwhm_rad=FWHM, lmax=lmax, rng=np.random.default_rng(1)).astype(
            float
        )

    few, order = sky(), highest_order(g, lmax)
    assert order < lmax
    monkeypatch.setattr("surveysim.timestreams.sky_maps.highest_order", lambda *_: min(lmax, 2 * order))
    # The numbers of lower orders are drawn first, so they stay.
    many = sky()
    np.testing.assert_allclose(few, many, atol=3e-6 * many.std())


@pytest.mark.parametrize("m", [0, 1])
def test_single_harmonics_of_the_curved_sky(m):
    """At l = 5700, where HEALPix pixels left 8 % of the power: Legendre's P_l, and -sin P_l' cos(azimuth)."""
    lmax, ell = 6000, 5700
    g = MapGeometry(2.3, 0.78, ARCMIN, 61, 61)
    # Orders are drawn in turn, each from l = m up: of order 0 real parts alone, then real and imaginary ones in turn.
    sky = curved_cmb_sky(
        g, BAND_POWER, CMB_PER_RJ, fwhm_rad=FWHM, lmax=lmax, rng=OneDeviate((ell, lmax + 1 + 2 * (ell - 1))[m])
    )
    xi, eta = pixel_centres(g)
    x = np.cos(np.arctan(np.hypot(xi, eta)))
    legendre = eval_legendre(ell, x)
    expected = np.sqrt(expected_psd(float(ell)) * (2 * ell + 1) / (4 * np.pi)) * legendre
    if m == 1:
        slope = ell * (eval_legendre(ell - 1, x) - x * legendre) / np.sqrt(1 - x**2).clip(1e-9)
        expected *= -np.sqrt(2 / (ell * (ell + 1))) * slope / legendre * np.cos(np.arctan2(eta, xi))
    np.testing.assert_allclose(sky, expected, atol=1e-5 * np.abs(expected).max())


def test_a_sky_that_is_too_large_is_refused(tmp_path):
    """With key, found and allowed, before anything is drawn."""
    (tmp_path / "wide.toml").write_text(without_sections(SMALL_SCENE, "score"))
    keys = {"scan.speed": "90 arcmin / s", "map.pixel": "2 arcmin", "sky.curved_lmax": 30_000}
    with pytest.raises(SceneError, match=r"sky.curved_lmax: found 30000, which takes .* 3e\+07 or fewer are expected"):
        prepare(load_scene(tmp_path / "wide.toml", keys))


@pytest.mark.slow
def test_curved_sky_has_the_power_of_the_flat_one_on_a_small_field():
    """6 skies on a field of 3.6 degrees to l = 4400 against the flat sky's expectation, in two ranges of l.

    The flat one has the modes of a plane of 14 degrees.
    """
    lmax, n, n_sky, pixel = 4400, 216, 6, ARCMIN
    g = MapGeometry(2.3, 0.78, pixel, n, n)
    taper = np.pad(tukey_taper(n, n, pixel, size_rad=n * pixel, edge_fraction=0.5), (0, n))
    rings = annuli(2 * n, 2 * n, pixel, edges_ell=np.array([1500.0, 3000, 4200]), taper=taper)
    rng = np.random.default_rng(5)
    skies = [curved_cmb_sky(g, BAND_POWER, CMB_PER_RJ, fwhm_rad=FWHM, lmax=lmax, rng=rng) for _ in range(n_sky)]
    psds = map_psd(np.pad(skies, ((0, 0), (0, n), (0, n))), taper, pixel, rings)
    ell = mode_ell(4 * n, 4 * n, pixel)
    expected = ring_mean(coupled_psd(expected_psd(ell), (4 * n, 4 * n), taper, pixel), rings)
    # A bin's steep spectrum has fewer modes than cells, by up to a half.
    error = np.sqrt(4 / (n_sky * rings.n_modes))
    assert (error < 0.03).all()
    assert (np.abs(psds.mean(axis=0) / expected - 1) < 3 * error).all()


def test_peak_of_a_flux_is_the_brightness_of_astropy():
    """At one frequency: the conversion of a flux density in a Gaussian beam to Rayleigh-Jeans temperature."""
    from astropy import units as u

    spectrum = {"flux": "12 mJy", "flux_frequency": "143 GHz", "spectral_index": 3.5}
    source = PointSource.model_validate({"ra": "132.3 deg", "dec": "44.8 deg"} | spectrum)
    area = 2 * np.pi * (FWHM / np.sqrt(8 * np.log(2))) ** 2 * u.sr
    expected = (12 * u.mJy / area).to(u.mK, u.brightness_temperature(143 * u.GHz))
    area_m2 = (299792458.0 / 143e9) ** 2 / area.value
    assert source_peak_mk(source, top_hat(143e9, 0.0), area_m2) == pytest.approx(expected.value, rel=1e-6)


@pytest.mark.parametrize("index", [-0.7, 0.0, 3.5])
def test_flux_is_averaged_over_the_band(index):
    """A top hat: the mean of a power law in closed form. The optics see one effective area at all frequencies."""
    band = top_hat(143e9, 0.3)
    spectrum = {"flux": "5 mJy", "flux_frequency": "90 GHz", "spectral_index": index}
    source, one = (
        PointSource.model_validate({"ra": "132.3 deg", "dec": "44.8 deg"} | spectrum | changes)
        for changes in ({}, {"flux_frequency": "143 GHz", "spectral_index": 0})
    )
    low, high = 143 * 0.85 / 90, 143 * 1.15 / 90
    mean = (high ** (index + 1) - low ** (index + 1)) / ((index + 1) * (high - low))
    found = source_peak_mk(source, band, 10.0) / source_peak_mk(one, band, 10.0)
    assert found == pytest.approx(mean, rel=1e-10)


def test_sources_of_a_flux_are_drawn(tmp_path):
    """The same sky as that of a source with this peak."""
    keys = {"ra": "08h49m20s", "dec": "+44d51m00s"}
    spectrum = {"flux": "500 mJy", "flux_frequency": "150 GHz", "spectral_index": 3}
    path = write_scene(tmp_path)
    by_flux = load_scene(path, {"sky.point_sources": [keys | spectrum]})
    peak_mk = source_peak_mk(by_flux.sky.point_sources[0], by_flux.instrument.band, effective_area_m2(by_flux))
    by_peak = load_scene(path, {"sky.point_sources": [keys | {"peak": f"{peak_mk} mK"}]})
    skies = [prepare(scene).sky.map_mk for scene in (by_flux, by_peak)]
    np.testing.assert_allclose(*skies, rtol=1e-6, atol=1e-9)
    assert peak_mk > 1
