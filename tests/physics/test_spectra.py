"""Band powers of skies with a spectrum like that of the CMB, their errors, and null tests of splits.

The validation page has larger samples (`docs/spectra_study.py`).
"""

import numpy as np
import pytest
from scipy import stats

from docs.spectra_study import BEAM, FWHM, NOISE_UK, PIXEL, cmb, null_tests, recovery, skies, uniformity
from mapmaker.cross_spectra import cross_band_powers, monte_carlo_covariance
from mapmaker.flat_spectra import flat_coupling
from mapmaker.spectrum import tukey_taper
from tests import naive

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def many():
    return recovery(300, 1)


@pytest.mark.parametrize("filtered", [False, True])
def test_a_hundred_skies_come_back(filtered):
    """Within sample variance, with the right chi-squared; filtered rows lose up to 13 % of the power."""
    found = recovery(100, 3, filtered=filtered)
    n_bin = len(found.expected)
    assert (np.abs(found.pull) < 4).all()
    assert 0.001 < stats.chi2.sf(np.sum(found.pull**2), n_bin) < 0.999
    tests = found.chi_squared(found.analytic)
    assert np.mean([item.value for item in tests]) == pytest.approx(n_bin, abs=4 * np.sqrt(2 * n_bin / 100))
    assert uniformity([item.pte for item in tests]) > 0.01
    if filtered:
        assert found.coupling.transfer.min() < 0.9


def test_a_hundred_skies_by_brute_force():
    """Each has the band powers of a dense matrix over all modes of the map and of the sky."""
    n, edges = 24, np.arange(600.0, 2700, 500)
    taper = tukey_taper(n, n, 2 * PIXEL, size_rad=2 * n * PIXEL, edge_fraction=1.0)
    coupling = flat_coupling(taper, 2 * PIXEL, edges_ell=edges, beam=BEAM)

    def window(k_y, k_x):
        pixels = np.sinc(k_y * PIXEL / np.pi) * np.sinc(k_x * PIXEL / np.pi)
        return np.exp(-(k_y**2 + k_x**2) * FWHM**2 / (8 * np.log(2))) * pixels**2

    matrix = naive.coupling_matrix(taper, 2 * PIXEL, edges, window, (4 * n, 4 * n))
    rng = np.random.default_rng(7)
    for _, sky in zip(range(100), skies(cmb, rng), strict=False):
        maps = sky[:n, :n] + NOISE_UK[:, None, None] * rng.standard_normal((3, n, n))
        expected = np.linalg.solve(matrix, naive.cross_pseudo_power(maps, taper, 2 * PIXEL, edges))
        np.testing.assert_allclose(cross_band_powers(maps, coupling).power_uk2, expected, rtol=1e-7)


def test_analytic_covariance(many):
    """Against 300 skies: errors, and correlations of all pairs of bins."""
    measured, n_sky = monte_carlo_covariance(many.found), 300
    assert (np.abs(many.error_ratio - 1) < 4 / np.sqrt(2 * n_sky)).all()
    matrices = [item.matrix_uk4 / np.outer(item.error_uk2, item.error_uk2) for item in (many.analytic, measured)]
    assert (np.abs(matrices[0] - matrices[1]) < 4.5 / np.sqrt(n_sky)).all()
    assert np.diag(matrices[0], 1).min() < -0.2


def test_probabilities_of_null_tests_are_uniform():
    """200 null tests, each with 20 realizations of its own, of noise that is neither white nor uniform."""
    found = [item.chi_squared for item in null_tests(200, 20, 5)]
    assert {item.distribution for item in found} == {"Hotelling"}
    assert uniformity([item.pte for item in found]) > 0.01
    naive_ptes = stats.chi2.sf([item.value for item in found], found[0].n_bin)
    assert uniformity(naive_ptes) < 1e-3
