"""Chi-squared, probability to exceed it, and null tests of splits."""

import numpy as np
import pytest
from scipy import stats

from mapmaker.cross_spectra import Covariance, monte_carlo_covariance
from mapmaker.errors import InsufficientDataError
from mapmaker.flat_spectra import flat_coupling
from mapmaker.null_tests import chi_squared, null_power, null_test
from mapmaker.spectrum import tukey_taper

N_BIN = 5
N, PIXEL = 48, np.radians(0.5 / 60)


@pytest.fixture(scope="module")
def coupling():
    taper = tukey_taper(N, N, PIXEL, size_rad=N * PIXEL, edge_fraction=0.5)
    return flat_coupling(taper, PIXEL, edges_ell=np.arange(2000.0, 12001, 2000), beam=np.ones_like)


def correlated(rng, shape):
    """Vectors of correlated bins of different errors."""
    mixing = np.eye(N_BIN) + 0.5 * np.eye(N_BIN, k=1)
    return rng.normal(size=(*shape, N_BIN)) @ mixing * np.arange(1, N_BIN + 1)


def test_known_covariance():
    matrix = np.diag([1.0, 4, 9])
    found = chi_squared(np.array([1.0, 2, 6]), Covariance(matrix, 0))
    assert (found.value, found.n_bin, found.distribution) == (pytest.approx(6), 3, "chi-squared")
    assert found.pte == pytest.approx(stats.chi2.sf(6, 3))
    some = chi_squared(np.array([1.0, 2, np.nan]), Covariance(matrix, 0), mask=np.array([False, True, True]))
    assert (some.value, some.n_bin) == (pytest.approx(1), 1)


def test_probabilities_are_uniform_with_few_realizations():
    """400 Gaussian vectors, each with 12 realizations of its own; the chi-squared distribution would be far off."""
    rng, n, n_realization = np.random.default_rng(1), 400, 12
    data, realized = correlated(rng, (n,)), correlated(rng, (n, n_realization))
    found = [chi_squared(x, monte_carlo_covariance(y)) for x, y in zip(data, realized, strict=True)]
    assert stats.kstest([item.pte for item in found], "uniform").pvalue > 0.01
    values = np.array([item.value for item in found])
    assert stats.kstest(stats.chi2.sf(values, N_BIN), "uniform").pvalue < 1e-4
    assert values.mean() == pytest.approx(N_BIN, abs=4 * values.std() / np.sqrt(n))


@pytest.mark.parametrize("common", [0.0, 0.3])
def test_null_tests_of_few_modes_are_uniform(coupling, common):
    """200 tests of powers of 10 to 20 modes, with 15 realizations that may have a part in common."""
    rng, n = np.random.default_rng(2), 200
    degrees = np.arange(10, 20, 2)
    shares = np.rint(degrees * np.array([common, 1 - common])[:, None])  # of modes that all realizations have

    def powers(modes, number):
        return rng.chisquare(np.tile(modes, (number, 1)))

    ptes = []
    for _ in range(n):
        shared = powers(np.maximum(shares[0], 1), 1) * (common > 0)
        realized = (shared + powers(shares[1], 15)) / degrees
        ptes.append(null_test(powers(degrees, 1)[0] / degrees, realized, coupling, common=common).chi_squared.pte)
    assert stats.kstest(ptes, "uniform").pvalue > 0.01


def test_too_few_realizations_have_no_probability(coupling):
    rng = np.random.default_rng(2)
    realized = rng.chisquare(9, size=(9, 5))
    found = null_test(realized[0], realized[1:8], coupling).chi_squared
    assert np.isnan(found.pte)
    assert np.isnan(found.value)
    assert found.flags[0] == "7 realizations of 5 bins: too few for a chi-squared"
    assert np.isfinite(null_test(realized[0], realized[1:], coupling).chi_squared.pte)
    with pytest.raises(InsufficientDataError, match="at least one bin with a band power"):
        chi_squared(np.array([np.nan]), Covariance(np.eye(1), 0))


def test_splits(coupling):
    """The sky cancels; noise of s1 and s2 in half the difference is (s1^2 + s2^2) / 4; a gain error is found."""
    rng = np.random.default_rng(3)
    sky = np.cumsum(rng.normal(size=(N, N)), axis=0)
    noise = rng.normal(size=(101, 2, N, N)) * np.array([2.0, 4])[:, None, None]
    realized = null_power(noise[1:], coupling)
    np.testing.assert_allclose(realized.mean(axis=0), 20 / 4 * PIXEL**2, rtol=0.06)
    power = null_power(noise[0] + sky, coupling)
    found = null_test(power, realized, coupling)
    assert 0.01 < found.chi_squared.pte < 0.99
    np.testing.assert_allclose(found.power_uk2, coupling.decouple(power - realized.mean(axis=0)))
    error = coupling.decouple(realized).std(axis=0, ddof=1)
    np.testing.assert_allclose(found.error_uk2, error * np.sqrt(1 + 1 / 100))
    wrong = null_test(null_power(noise[0] + sky * np.array([1, 2])[:, None, None], coupling), realized, coupling)
    assert wrong.chi_squared.pte < 1e-6
    some = null_test(power, realized, coupling, mask=np.arange(5) > 2)
    assert some.chi_squared.n_bin == 2
