"""Noise and skies of known spectrum through the estimator: level, scatter, bias, and the error of the score.

A standard deviation from n draws is known to 1 / sqrt(2 n); the tests allow three times that unless said
otherwise.
"""

import numpy as np
import pytest
from scipy import fft

from mapmaker.bandpower import estimate_amplitude, flat_band_power, flat_spectrum_psd
from mapmaker.spectrum import annuli, map_psd, mode_ell, neighbour_correlation, tukey_taper
from mapmaker.uncertainty import noise_error, transfer_function_error
from tests.toys import N_MODES, PSD, toy_score

PIXEL_RAD = np.radians(20 / 3600)
N_PIX = 96
SIDE_RAD = N_PIX * PIXEL_RAD
EDGES = np.arange(4000.0, 16001.0, 1000.0)


def psd_relative_error(n_modes):
    """Of the PSD of Gaussian noise with n real degrees of freedom."""
    return np.sqrt(2 / np.asarray(n_modes))


def gaussian_maps(psd_of_ell, n_maps, rng):
    """Periodic maps whose PSD is that function of ell: white noise filtered in Fourier space."""
    white = fft.rfft2(rng.normal(size=(n_maps, N_PIX, N_PIX)))
    amplitude = np.sqrt(psd_of_ell(mode_ell(N_PIX, N_PIX, PIXEL_RAD))) / PIXEL_RAD
    return fft.irfft2(white * amplitude, s=(N_PIX, N_PIX))


@pytest.mark.parametrize("edge_fraction, size_pix", [(0.0, N_PIX), (0.5, N_PIX), (1.0, N_PIX), (0.5, 64)])
def test_white_noise_level_and_mode_count(edge_fraction, size_pix):
    """The level is s^2 pixel^2; bins wide against the taper's resolution scatter by sqrt(2 / n).

    600 maps: the mean is known to sqrt(2 / n / 600), the scatter to 3 %; a bin's rim, where correlated modes
    fall into the next bin, takes up to 6 % off the variance (3 % off the scatter).
    """
    n_maps = 600
    taper = tukey_taper(N_PIX, N_PIX, PIXEL_RAD, size_rad=size_pix * PIXEL_RAD, edge_fraction=edge_fraction)
    rings = annuli(N_PIX, N_PIX, PIXEL_RAD, edges_ell=np.array([1000.0, 10000.0, 20000.0, 30000.0]), taper=taper)
    maps = 3 * np.random.default_rng(1).normal(size=(n_maps, N_PIX, N_PIX))
    psd = map_psd(maps, taper, PIXEL_RAD, rings) / (9 * PIXEL_RAD**2)
    expected = psd_relative_error(rings.n_modes)
    assert (np.abs(psd.mean(axis=0) - 1) < 4 * expected / np.sqrt(n_maps)).all()
    np.testing.assert_allclose(psd.std(axis=0), expected, rtol=3 / np.sqrt(2 * n_maps) + 0.03)


def test_unhit_pixels_around_the_taper_change_nothing():
    taper = tukey_taper(N_PIX, N_PIX, PIXEL_RAD, size_rad=64 * PIXEL_RAD, edge_fraction=0.5)
    rings = annuli(N_PIX, N_PIX, PIXEL_RAD, edges_ell=EDGES, taper=taper)
    maps = np.random.default_rng(2).normal(size=(2, N_PIX, N_PIX))
    maps[1] = np.where(taper > 0, maps[0], 0)
    psd = map_psd(maps, taper, PIXEL_RAD, rings)
    np.testing.assert_allclose(psd[0], psd[1])


@pytest.mark.parametrize("ruling", [0.0, 0.5, 0.9, 1.0])
def test_errors_of_a_sum_over_bins_that_share_modes(ruling):
    """Variance of a weighted sum over 12 bins of white maps, from the bins' own scatter and from their mode counts.

    Bins are half wider than the map's modes, 675 in ell. One has `ruling` of the weight, the rest is even. 1500 maps
    know a variance to 3.7 %.
    """
    n_maps = 1500
    taper = tukey_taper(N_PIX, N_PIX, PIXEL_RAD, size_rad=SIDE_RAD, edge_fraction=1.0)
    rings = annuli(N_PIX, N_PIX, PIXEL_RAD, edges_ell=EDGES, taper=taper)
    psd = map_psd(np.random.default_rng(9).normal(size=(n_maps, N_PIX, N_PIX)), taper, PIXEL_RAD, rings)
    relative, n_bin = psd / psd.mean(axis=0), len(rings.ell)
    weight = np.full(n_bin, (1 - ruling) / (n_bin - 1))
    weight[8] = ruling if ruling else weight[0]
    weight /= weight.sum()
    found, correlation = (relative @ weight).var(ddof=1), neighbour_correlation(taper, rings)
    tolerance = 4 * np.sqrt(2 / n_maps)
    assert transfer_function_error(relative.std(axis=0, ddof=1), weight, correlation) ** 2 == pytest.approx(
        found, rel=tolerance
    )
    # Realizations of one and the same PSD leave the mode counts alone: 16 of 16 + K - 1 parts of the variance.
    still = np.ones((2, n_bin))
    counted = (
        noise_error(still, weight, np.ones(1000), n_modes=rings.n_modes, correlation=correlation) ** 2
        * 17
        / 16
        / (0.999 / 2 + 1e-3)
    )
    assert counted == pytest.approx(found, rel=tolerance + 0.03)


def test_narrow_bins_share_their_information():
    """Bins narrower than the taper's resolution scatter by less than 2 / n, a smooth sum by 2 / sum n."""
    n_maps = 1500
    taper = tukey_taper(N_PIX, N_PIX, PIXEL_RAD, size_rad=SIDE_RAD, edge_fraction=1.0)
    rings = annuli(N_PIX, N_PIX, PIXEL_RAD, edges_ell=np.arange(4000.0, 16001.0, 500.0), taper=taper)
    psd = map_psd(np.random.default_rng(3).normal(size=(n_maps, N_PIX, N_PIX)), taper, PIXEL_RAD, rings)
    relative = psd / psd.mean(axis=0)
    assert np.mean(relative.var(axis=0) * rings.n_modes / 2) < 0.9
    together = relative @ rings.n_modes / rings.n_modes.sum()
    tolerance = 3 / np.sqrt(2 * n_maps) + 0.03
    np.testing.assert_allclose(together.std(), psd_relative_error(rings.n_modes.sum()), rtol=tolerance)


@pytest.mark.parametrize("edge_fraction", [0.0, 1.0])
def test_known_spectrum_comes_back(edge_fraction):
    """A flat spectrum within the error of 600 maps; a Hann taper adds 2/3 (2 pi / (side ell))^2."""
    n_maps = 600
    taper = tukey_taper(N_PIX, N_PIX, PIXEL_RAD, size_rad=SIDE_RAD, edge_fraction=edge_fraction)
    rings = annuli(N_PIX, N_PIX, PIXEL_RAD, edges_ell=EDGES, taper=taper)
    maps = gaussian_maps(lambda ell: flat_spectrum_psd(np.maximum(ell, 500)), n_maps, np.random.default_rng(4))
    within_bin = annuli_mean(lambda ell: flat_spectrum_psd(np.maximum(ell, 500)), rings)
    ratio = map_psd(maps, taper, PIXEL_RAD, rings).mean(axis=0) / within_bin
    leakage = 2 / 3 * edge_fraction * (2 * np.pi / (SIDE_RAD * rings.ell)) ** 2
    assert (np.abs(ratio - 1 - leakage) < 4 * psd_relative_error(rings.n_modes * n_maps) + leakage).all()


def annuli_mean(psd_of_ell, rings):
    """Mean of a spectrum over the modes of each bin."""
    ell = np.maximum(mode_ell(N_PIX, N_PIX, PIXEL_RAD), 1).ravel()
    power = np.bincount(rings.bin_of_mode, rings.multiplicity * psd_of_ell(ell))
    return (power / np.bincount(rings.bin_of_mode, rings.multiplicity))[:-1]


@pytest.mark.parametrize("edge_fraction", [0.0, 1.0])
def test_scatter_of_the_amplitude_is_the_score(edge_fraction):
    """Flat CMB of 0.2 sigma under white noise: estimates are unbiased and scatter as `flat_band_power`.

    800 maps: the scatter within 3 / sqrt(1600) and 3 % for modes shared across the cuts of the selected
    range.
    """
    n_maps, rng = 800, np.random.default_rng(5)
    taper = tukey_taper(N_PIX, N_PIX, PIXEL_RAD, size_rad=SIDE_RAD, edge_fraction=edge_fraction)
    rings = annuli(N_PIX, N_PIX, PIXEL_RAD, edges_ell=EDGES, taper=taper)
    mask = rings.ell > 5000
    noise_psd = np.full(rings.ell.size, 1e-5)
    signal_psd = annuli_mean(flat_spectrum_psd, rings)
    sigma = flat_band_power(noise_psd, signal_psd, rings.n_modes, mask)
    sky = gaussian_maps(lambda ell: 0.2 * sigma * flat_spectrum_psd(np.maximum(ell, 500)), n_maps, rng)
    maps = sky + np.sqrt(1e-5) / PIXEL_RAD * rng.normal(size=sky.shape)
    psd = map_psd(maps, taper, PIXEL_RAD, rings)
    amplitude = estimate_amplitude(
        psd, noise_psd_ukcmb2=noise_psd, signal_psd=signal_psd, n_modes=rings.n_modes, mask=mask
    )
    np.testing.assert_allclose(amplitude.std(), sigma, rtol=3 / np.sqrt(2 * n_maps) + 0.03)
    np.testing.assert_allclose(amplitude.mean(), 0.2 * sigma, atol=3.5 * sigma / np.sqrt(n_maps))


def toy_survey(weights, n_real, rng):
    """PSDs (n_real, n_bin) of sign-flipped co-adds of observations of inverse variance `weights`."""
    signs = rng.choice([-1.0, 1.0], size=(n_real, weights.size))
    psds = np.empty((n_real, N_MODES.size))
    for b, n in enumerate(N_MODES):
        unit = rng.normal(size=(weights.size, n // 2, 2)) @ [1, 1j] / np.sqrt(2)
        coadd = signs @ (np.sqrt(weights)[:, None] * unit) / weights.sum()
        psds[:, b] = PSD * np.mean(np.abs(coadd) ** 2, axis=1)
    return psds


@pytest.mark.parametrize("weather_varies", [False, True])
def test_error_of_the_score_is_its_scatter_over_surveys(weather_varies):
    """400 toy surveys of 60 observations of unequal weight and 16 realizations each.

    With the same weights in all surveys only the noise part scatters; with new weather each time the weather
    part as well. The mean predicted variance against the scatter of ln sigma, within 3 / sqrt(800) = 11 %.
    """
    n_surveys, rng = 400, np.random.default_rng(6)
    weights = np.exp(0.8 * rng.normal(size=60))
    log_sigma, variance = np.empty(n_surveys), np.empty(n_surveys)
    for i in range(n_surveys):
        if weather_varies:
            weights = np.exp(0.8 * rng.normal(size=60))
        psds = toy_survey(weights, 16, rng)
        result, budget = toy_score(psds, weights)
        log_sigma[i] = np.log(result.sigma_ukcmb2)
        variance[i] = budget.total**2 if weather_varies else budget.noise**2
    np.testing.assert_allclose(log_sigma.std(), np.sqrt(variance.mean()), rtol=3 / np.sqrt(2 * n_surveys))
