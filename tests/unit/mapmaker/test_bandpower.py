"""Exact properties of the band-power formulas, the width of a weight, and what they reject."""

import numpy as np
import pytest

from mapmaker.bandpower import (
    band_power,
    bin_weights,
    estimate_amplitude,
    flat_band_power,
    flat_band_power_fixed_weights,
    flat_spectrum_psd,
    score,
    weight_fwhm,
)
from mapmaker.uncertainty import (
    information_shares,
    noise_error,
    noise_error_parts,
    transfer_function_error,
    weather_error,
)

EDGES = np.arange(1000.0, 12001.0, 500.0)
ELL = (EDGES[:-1] + EDGES[1:]) / 2
N_MODES = ELL / 50
SIGNAL = flat_spectrum_psd(ELL)
NOISE = 1e-5 * (1 + (3000 / ELL) ** 4) * np.exp((ELL / 9000) ** 2)
MASK = ELL > 4000


def test_flat_spectrum():
    np.testing.assert_allclose(flat_spectrum_psd(np.array([1.0, 4000.0])), [np.pi, 2 * np.pi / (4000 * 4001)])


def test_one_bin_is_the_error_of_its_psd():
    one = np.arange(ELL.size) == 9
    expected = np.sqrt(2 / N_MODES[9]) * NOISE[9] / SIGNAL[9]
    np.testing.assert_allclose(flat_band_power(NOISE, SIGNAL, N_MODES, one), expected)


def test_equal_bins_average_down():
    ones = np.ones(8)
    np.testing.assert_allclose(flat_band_power(3 * ones, ones, 2 * ones, ones > 0), 3 / np.sqrt(8))


def test_unselected_bins_may_hold_anything():
    noise = np.where(MASK, NOISE, np.nan)
    result = band_power(noise, SIGNAL, N_MODES, MASK, ell=ELL, edges_ell=EDGES, relative_error=0.0)
    assert result.sigma_ukcmb2 == flat_band_power(NOISE, SIGNAL, N_MODES, MASK)
    assert (result.weight[~MASK] == 0).all()


def test_fixed_weights_reduce_to_the_optimum_and_never_beat_it():
    best = flat_band_power(NOISE, SIGNAL, N_MODES, MASK)
    same = flat_band_power_fixed_weights(NOISE, SIGNAL, N_MODES, MASK, weighting_noise_psd_ukcmb2=7 * NOISE)
    np.testing.assert_allclose(same, best)
    rng = np.random.default_rng(1)
    for _ in range(50):
        other = NOISE * np.exp(rng.normal(size=NOISE.size))
        assert flat_band_power_fixed_weights(NOISE, SIGNAL, N_MODES, MASK, weighting_noise_psd_ukcmb2=other) > best


def test_fixed_weights_by_hand():
    """Bins of N = (1, 2), M = 1, n = 2 weighted equally (R = 1): A = (A_1 + A_2) / 2 of variance 5 / 4."""
    ones = np.ones(2)
    sigma = flat_band_power_fixed_weights(
        np.array([1.0, 2.0]), ones, 2 * ones, ones > 0, weighting_noise_psd_ukcmb2=ones
    )
    np.testing.assert_allclose(sigma, np.sqrt(5) / 2)


def test_amplitude_of_exact_psds():
    amplitude = np.array([[0.0, 3.0], [-2.0, 1e4]])
    psd = NOISE + amplitude[..., None] * SIGNAL
    np.testing.assert_allclose(
        estimate_amplitude(psd, noise_psd_ukcmb2=NOISE, signal_psd=SIGNAL, n_modes=N_MODES, mask=MASK),
        amplitude,
        atol=1e-9,
    )


def test_band_power_is_consistent():
    result = band_power(NOISE, SIGNAL, N_MODES, MASK, ell=ELL, edges_ell=EDGES, relative_error=0.02)
    first = np.argmax(MASK)
    np.testing.assert_allclose(result.weight.sum(), 1)
    np.testing.assert_allclose(result.ell_eff, np.average(ELL, weights=N_MODES * MASK * (SIGNAL / NOISE) ** 2))
    np.testing.assert_allclose(result.cumulative[: first + 1], result.sigma_ukcmb2)
    assert (np.diff(result.cumulative[first:]) > 0).all()
    number = np.arange(ELL.size)
    from_there = [flat_band_power(NOISE, SIGNAL, N_MODES, number >= b) for b in number[first:]]
    np.testing.assert_allclose(result.cumulative[first:], from_there)
    np.testing.assert_allclose(result.error_ukcmb2, 0.02 * result.sigma_ukcmb2)


def test_nothing_is_left_above_the_last_selected_bin():
    below = np.arange(ELL.size) < 10
    result = band_power(NOISE, SIGNAL, N_MODES, below, ell=ELL, edges_ell=EDGES, relative_error=0.0)
    assert np.isinf(result.cumulative[~below]).all()


def test_width_of_known_shapes():
    edges = np.arange(0.0, 2001.0, 20.0)
    ell = (edges[:-1] + edges[1:]) / 2
    everywhere = np.ones(ell.size, dtype=bool)
    gauss = np.exp(-((ell - 1003) ** 2) / (2 * 150**2))
    full = 150 * np.sqrt(8 * np.log(2))
    np.testing.assert_allclose(weight_fwhm(gauss, edges, everywhere), full, rtol=2e-3)
    np.testing.assert_allclose(weight_fwhm(gauss, edges, ell > 1000), full / 2 + 3, rtol=4e-3)
    np.testing.assert_allclose(weight_fwhm(everywhere * 1.0, edges, everywhere), 2000)
    triangle = np.maximum(0, 1 - np.abs(ell - 1010) / 500)
    np.testing.assert_allclose(weight_fwhm(triangle, edges, everywhere), 500)


def test_width_does_not_depend_on_the_binning():
    """A weight per unit ell that falls linearly from a cut, in bins of equal and of unequal width."""
    fine, coarse = (
        np.arange(4000.0, 8001.0, 100.0),
        np.array([4000.0, 4200.0, 4900.0, 5500.0, 6700.0, 8000.0]),
    )
    widths = []
    for edges in (fine, coarse):
        weight = -np.diff((8000 - edges) ** 2)
        widths.append(weight_fwhm(weight, edges, weight > 0))
    np.testing.assert_allclose(widths, 2000, rtol=0.04)


def test_width_of_a_single_bin_is_its_own():
    one = np.arange(ELL.size) == 4
    np.testing.assert_allclose(weight_fwhm(1.0 * one, EDGES, one), 500)


def test_error_parts_by_hand():
    """Two equal observations correlate by 1/2: s^2 of the PSDs (1, 3) is 2 / 4 of the mean squared."""
    psds, one = np.array([[1.0, np.nan], [3.0, np.nan]]), np.array([1.0, 0.0])
    np.testing.assert_allclose(noise_error(psds, one, np.ones(2)), np.sqrt(0.5 / 0.5 * (1 / 2 + 1 / 2 * 1 / 2)))
    # 10 of 1 and 10 of 3: variance 20/19 of 1, mean 2; Student's t of 20 has the variance 19/17.
    weather = weather_error(np.repeat([1.0, 3.0], 10))
    np.testing.assert_allclose(weather, np.sqrt(20 / 19 / 20 / 4 * 19 / 17))
    assert np.isnan(weather_error(np.arange(1.0, 16.0)))
    np.testing.assert_allclose(transfer_function_error(np.array([0.3, 0.4]), np.array([0.5, 0.5])), 0.25)


def test_counted_modes_stand_in_for_a_scatter_of_few_realizations():
    """The closed form weighs as 16 degrees of freedom beside the K - 1 of the scatter, whatever the weights."""
    weight, weights = np.array([0.25, 0.75]), np.array([1.0, 1.0, 2.0])
    n_modes, common = np.array([10.0, 30.0]), 6 / 16
    counted = (0.25**2 * 2 / 10 + 0.75**2 * 2 / 30) * 16 / 17
    psds = np.ones((2, 2))  # no scatter at all
    signs, shared = noise_error_parts(psds, weight, weights, n_modes=n_modes)
    np.testing.assert_allclose([signs**2, shared**2], [counted * (1 - common) / 2, counted * common])
    assert noise_error(psds, weight, weights) == 0


def test_the_noise_of_weights_is_not_counted_as_weather():
    weights = np.repeat([1.0, 3.0], 10)
    scatter = weather_error(weights) * np.sqrt(17 / 19)
    np.testing.assert_allclose(weather_error(weights, 0.6 * scatter), 0.8 * weather_error(weights))
    assert weather_error(weights, 2 * scatter) == 0


def test_an_observation_without_data_is_part_of_the_sample():
    """19 equal observations and one that lost all: the relative variance of their mean is 1 / (19 * 19)."""
    information = np.append(np.ones(19), 0.0)
    np.testing.assert_allclose(weather_error(information), np.sqrt(19 / 17) / 19)


def scored(psds, errors, weights):
    """Score of PSDs of noise realizations, with the bins of this file."""
    return score(
        psds,
        SIGNAL,
        signal_psd_relative_error=errors,
        n_modes=N_MODES,
        mask=MASK,
        observation_weights=weights,
        ell=ELL,
        edges_ell=EDGES,
    )


def test_score_joins_its_parts():
    rng = np.random.default_rng(2)
    psds = NOISE * rng.chisquare(N_MODES, size=(8, NOISE.size)) / N_MODES
    weights, errors = rng.uniform(1, 2, 30), np.full(NOISE.size, 0.1)
    result, budget = scored(psds, errors, weights)
    assert result.sigma_ukcmb2 == flat_band_power(psds.mean(axis=0), SIGNAL, N_MODES, MASK)
    signs, common = noise_error_parts(psds, result.weight, weights, n_modes=N_MODES)
    assert budget.noise == pytest.approx(np.hypot(signs, common))
    assert budget.weather == weather_error(weights, common)
    np.testing.assert_allclose(budget.transfer_function, 0.1 * np.sqrt(np.sum(result.weight**2)))
    parts = budget.noise**2 + budget.weather**2 + budget.transfer_function**2
    np.testing.assert_allclose(result.error_ukcmb2, result.sigma_ukcmb2 * np.sqrt(parts))


@pytest.mark.parametrize(
    "noise, signal, n_modes, mask, message",
    [
        (NOISE, SIGNAL, N_MODES, np.zeros(ELL.size, dtype=bool), "at least one bin"),
        (NOISE, SIGNAL, N_MODES, MASK.astype(int), "boolean"),
        (NOISE * 0, SIGNAL, N_MODES, MASK, "noise PSD must be positive"),
        (NOISE * np.nan, SIGNAL, N_MODES, MASK, "noise PSD must be positive"),
        (NOISE, SIGNAL, -N_MODES, MASK, "number of modes must be positive and finite"),
        (NOISE, SIGNAL * 0, N_MODES, MASK, "signal PSD"),
        (NOISE, SIGNAL * np.nan, N_MODES, MASK, "signal PSD"),
        (NOISE[1:], SIGNAL, N_MODES, MASK, r"must all be \(n_bin,\)"),
        (NOISE[None], SIGNAL[None], N_MODES[None], MASK[None], r"must all be \(n_bin,\)"),
    ],
)
def test_bad_bins_are_rejected(noise, signal, n_modes, mask, message):
    with pytest.raises(ValueError, match=message):
        flat_band_power(noise, signal, n_modes, mask)
    with pytest.raises(ValueError, match=message):
        flat_band_power_fixed_weights(noise, signal, n_modes, mask, weighting_noise_psd_ukcmb2=noise)
    with pytest.raises(ValueError, match=message):
        estimate_amplitude(noise, noise_psd_ukcmb2=noise, signal_psd=signal, n_modes=n_modes, mask=mask)


def test_the_weighting_noise_is_checked_too():
    with pytest.raises(ValueError, match="noise PSD must be positive"):
        flat_band_power_fixed_weights(NOISE, SIGNAL, N_MODES, MASK, weighting_noise_psd_ukcmb2=0 * NOISE)


def test_other_shapes_are_rejected():
    with pytest.raises(ValueError, match="psd_ukcmb2"):
        estimate_amplitude(np.ones((3, 2)), noise_psd_ukcmb2=NOISE, signal_psd=SIGNAL, n_modes=N_MODES, mask=MASK)
    with pytest.raises(ValueError, match="one edge more"):
        band_power(NOISE, SIGNAL, N_MODES, MASK, ell=ELL, edges_ell=ELL, relative_error=0.0)


@pytest.mark.parametrize(
    "psds, errors, weights, message",
    [
        (NOISE[None], SIGNAL, np.ones(4), "at least 2 noise realizations"),
        (NOISE, SIGNAL, np.ones(4), "at least 2 noise realizations"),
        (np.stack([NOISE] * 2), SIGNAL[1:], np.ones(4), "signal PSD errors"),
        (np.stack([NOISE] * 2), SIGNAL, np.ones(1), "2 or more are expected"),
        (np.stack([NOISE] * 2), SIGNAL, np.array([1.0, 0.0]), "weights must be positive and finite"),
    ],
)
def test_score_rejects_too_little(psds, errors, weights, message):
    with pytest.raises(ValueError, match=message):
        scored(psds, errors, weights)


def test_information_shares_are_what_sigma_answers_to():
    """d ln sigma of a little more of one observation's data, from the co-added noise itself."""
    rng, n_obs, n_bin = np.random.default_rng(3), 5, 4
    weights, data = rng.uniform(0.5, 2.0, n_obs), rng.uniform(0.3, 1.0, n_obs)
    noise, modes, mask = rng.uniform(0.5, 2.0, (n_obs, n_bin)), np.array([10, 20, 30, 40]), np.array([0, 1, 1, 1], bool)
    signal = 1 / np.arange(1.0, n_bin + 1)

    def sigma(of_data):
        co_added = (weights**2 * of_data) @ noise / np.sum(weights * of_data) ** 2
        return flat_band_power(co_added, signal, modes, mask), bin_weights(co_added, signal, modes, mask)

    found = information_shares(weights, data, noise, sigma(data)[1])
    step = 1e-6 * np.eye(n_obs)
    slope = [np.log(sigma(data * (1 + up))[0] / sigma(data * (1 - up))[0]) / 2e-6 for up in step]
    np.testing.assert_allclose(found, -np.array(slope), atol=1e-8)
    assert found.sum() == pytest.approx(1)


def test_information_of_noise_that_is_alike_in_all_bins_is_the_weight():
    weights, data = np.array([1.0, 3.0, 0.0, 2.0]), np.array([1.0, 0.5, 1.0, 1.0])
    noise = np.array([[1.0], [1 / 3], [np.inf], [0.5]]) * np.ones((1, 3))
    expected = weights * data / np.sum(weights * data)
    np.testing.assert_allclose(information_shares(weights, data, noise, np.array([0.0, 0.4, 0.6])), expected)
