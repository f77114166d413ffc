"""Band powers of splits and their covariances against closed forms, brute force and skies."""

from functools import partial

import numpy as np
import pytest

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.cross_spectra import cross_band_powers, monte_carlo_covariance, realized_band_powers
from mapmaker.errors import InsufficientDataError
from mapmaker.flat_spectra import flat_coupling
from mapmaker.spectrum import mode_ell, tukey_taper
from mapmaker.transfer_function import beam_window, mode_pixel_window
from tests import naive

PIXEL = np.radians(0.5 / 60)
BEAM = partial(beam_window, fwhm_rad=np.radians(1 / 60))
EDGES = np.arange(2000.0, 12001, 2000)


@pytest.fixture(scope="module")
def coupling():
    taper = tukey_taper(48, 48, PIXEL, size_rad=48 * PIXEL, edge_fraction=0.5)
    return flat_coupling(taper, PIXEL, edges_ell=EDGES, beam=BEAM)


def test_brute_force():
    """Pairs one by one, and a dense matrix over all modes of map and sky."""
    rng = np.random.default_rng(1)
    taper, maps = rng.uniform(0.1, 1, (8, 10)), rng.normal(size=(3, 8, 10))
    edges = np.array([3000.0, 7000, 12000, 20000])
    found = cross_band_powers(maps, flat_coupling(taper, PIXEL, edges_ell=edges, beam=BEAM, sky_shape=(17, 24)))

    def window(k_y, k_x):
        s = np.radians(1 / 60) / np.sqrt(8 * np.log(2))
        return (
            np.exp(-(k_y**2 + k_x**2) * s**2)
            * (np.sinc(k_y * PIXEL / 2 / np.pi) * np.sinc(k_x * PIXEL / 2 / np.pi)) ** 2
        )

    matrix = naive.coupling_matrix(taper, PIXEL, edges, window, (17, 24))
    expected = np.linalg.solve(matrix, naive.cross_pseudo_power(maps, taper, PIXEL, edges))
    np.testing.assert_allclose(found.power_uk2, expected, rtol=1e-9)


def test_noise_of_each_map_is_what_the_cross_power_lacks(coupling):
    """Maps of noise alone, of different levels: their PSD is pixel^2 s^2."""
    level = np.array([3.0, 5, 8])
    maps = np.random.default_rng(2).normal(size=(100, 3, 48, 48)) * level[:, None, None]
    pseudo = coupling.field.pseudo_power(maps).mean(axis=0)
    np.testing.assert_allclose(pseudo, (level * PIXEL)[:, None] ** 2 * np.ones(5), rtol=0.05)
    found = cross_band_powers(maps[0], coupling)
    by_hand = coupling.decouple(coupling.field.pseudo_power(maps[0]))
    np.testing.assert_allclose(found.noise_uk2, by_hand - found.power_uk2, rtol=1e-9)
    realized = realized_band_powers(maps, coupling)
    np.testing.assert_allclose(realized[0], found.power_uk2, rtol=1e-12)
    error = realized.std(axis=0) / 10
    assert (np.abs(realized.mean(axis=0)) < 4 * error).all()
    assert (error < 0.02 * by_hand.mean(axis=0)).all()


@pytest.mark.parametrize(("signal", "n_map"), [(0.0, 2), (0.0, 4), (30.0, 2), (1e5, 3)])
def test_knox(signal, n_map):
    """n maps of one noise N, a bin apart from others: ``2 / n_modes (S^2 + 2 S N / n + N^2 / (n (n - 1)))``."""
    box = flat_coupling(np.ones((48, 48)), PIXEL, edges_ell=np.array([4000.0, 12000]), beam=np.ones_like)
    maps = np.random.default_rng(3).normal(size=(n_map, 48, 48))
    maps -= maps.mean(axis=0)  # alike in noise to the last digit: two maps are opposite
    found = cross_band_powers(maps, box, signal_uk2=np.array([signal]))
    noise = found.noise_uk2[:, 0]
    uneven = [a * b for i, a in enumerate(noise) for b in noise[:i]]
    expected = signal**2 + 2 * signal * noise.mean() / n_map + 2 * np.sum(uneven) / (n_map * (n_map - 1)) ** 2
    variance = found.covariance.matrix_uk4[0, 0]
    assert variance == pytest.approx(2 / box.n_modes[0] * expected, rel=1e-9)


def draw(spectrum, n_sky, noise_uk, rng):
    """Splits (16 n_sky, n_map, 48, 48) of patches of skies 4 times as large."""
    ell = mode_ell(192, 192, PIXEL)
    power = spectrum(ell) * flat_spectrum_psd(ell) * BEAM(ell) * mode_pixel_window(192, 192, PIXEL, PIXEL)
    skies = np.fft.irfft2(np.fft.rfft2(rng.normal(size=(n_sky, 192, 192))) * np.sqrt(power) / PIXEL, (192, 192))
    patches = skies.reshape(n_sky, 4, 48, 4, 48).swapaxes(2, 3).reshape(-1, 1, 48, 48)
    noise = rng.normal(size=(len(patches), len(noise_uk), 48, 48)) * np.array(noise_uk)[:, None, None]
    return patches + noise


def test_skies_come_back(coupling):
    """160 skies in three maps: mean, errors and correlations of neighbours within the scatter of their number."""

    def spectrum(ell):
        return 40 + 200 * np.exp(-ell / 4000)

    maps = draw(spectrum, 10, (2.0, 3, 4), np.random.default_rng(4))
    expected = coupling.windows @ spectrum(coupling.window_ell)
    realized = realized_band_powers(maps, coupling)
    measured = monte_carlo_covariance(realized)
    assert (np.abs(realized.mean(axis=0) - expected) < 4 * measured.error_uk2 / np.sqrt(160)).all()
    analytic = cross_band_powers(maps[0], coupling, signal_uk2=expected).covariance
    # Errors from 160 skies are known to 5.6 %, correlations to 8 %.
    assert (np.abs(analytic.error_uk2 / measured.error_uk2 - 1) < 0.2).all()
    correlations = [
        np.diag(item.matrix_uk4 / np.outer(item.error_uk2, item.error_uk2), 1) for item in (analytic, measured)
    ]
    np.testing.assert_allclose(*correlations, atol=0.3)
    assert np.mean(correlations[0]) == pytest.approx(np.mean(correlations[1]), abs=0.12)


def test_distant_power_is_flagged(coupling):
    maps = np.random.default_rng(5).normal(size=(2, 48, 48))
    steep = np.array([1e4, 100, 1, 1, 1])
    found = cross_band_powers(maps, coupling, signal_uk2=steep).covariance
    assert found.flags == (
        "5 of 5 bins: more than 5 % of the power comes from distant multipoles, and analytic errors are too small",
    )
    assert cross_band_powers(30 * maps, coupling, signal_uk2=np.ones(5)).covariance.flags == ()


def test_stripes_are_flagged(coupling):
    """Noise that is 20 times as strong along one direction; white noise is not flagged, nor is a bright sky."""
    white = np.random.default_rng(7).normal(size=(2, 48, 48))
    along = np.abs(np.fft.rfftfreq(48))
    stripes = np.fft.irfft(np.fft.rfft(white) * np.sqrt(1 + 20 * (along < 0.1)), 48)
    faint, bright = np.ones(5), np.full(5, 1e6)
    (flag,) = cross_band_powers(30 * stripes, coupling, signal_uk2=faint).covariance.flags
    assert flag.startswith("noise depends on the direction of modes: true errors are larger, by some ")
    assert cross_band_powers(30 * white, coupling, signal_uk2=faint).covariance.flags == ()
    for item in cross_band_powers(30 * stripes, coupling, signal_uk2=bright).covariance.flags:
        assert "direction" not in item
    np.testing.assert_allclose(coupling.field.unevenness(white[0]), 1, atol=0.5)


def test_covariance_is_positive():
    """Two maps whose noise differs in colour: no combination of bins has a negative variance."""
    taper = tukey_taper(48, 48, PIXEL, size_rad=48 * PIXEL, edge_fraction=1.0)
    narrow = flat_coupling(taper, PIXEL, edges_ell=np.arange(2000.0, 12001, 1000), beam=BEAM)
    white = np.random.default_rng(8).normal(size=(2, 48, 48))
    ell = mode_ell(48, 48, PIXEL)
    steep = np.fft.irfft2(np.fft.rfft2(white[0]) * (1 + (8000 / np.maximum(ell, 500)) ** 3), (48, 48))
    found = cross_band_powers(np.array([steep, white[1]]), narrow, signal_uk2=np.zeros(10)).covariance.matrix_uk4
    assert np.linalg.eigvalsh(found / np.sqrt(np.outer(np.diag(found), np.diag(found)))).min() > 0


def test_few_realizations_are_flagged():
    rng = np.random.default_rng(6)
    assert monte_carlo_covariance(rng.normal(size=(60, 5))).flags == ()
    assert monte_carlo_covariance(rng.normal(size=(7, 5))).flags == (
        "7 realizations of 5 bins: too few for a chi-squared",
        "7 realizations determine errors of band powers to 29 %",
    )
    lost = rng.normal(size=(60, 5))
    lost[:, 2] = np.nan
    error = monte_carlo_covariance(lost).error_uk2
    np.testing.assert_allclose(error, np.where(np.arange(5) == 2, np.nan, lost.std(axis=0, ddof=1)))


def test_refusals(coupling):
    with pytest.raises(InsufficientDataError, match="cross-spectra need at least 2 maps, got 1"):
        cross_band_powers(np.ones((1, 48, 48)), coupling)
    with pytest.raises(ValueError, match=r"maps_uk: found the shape \(2, 48, 40\); \(n_map, 48, 48\) is expected"):
        cross_band_powers(np.ones((2, 48, 40)), coupling)
    with pytest.raises(InsufficientDataError, match="needs at least 2 realizations, got 1"):
        monte_carlo_covariance(np.ones((1, 3)))
