"""Adaptive PCA: twin, planted modes, degenerate eigenvalues, few samples, matrices too large for all eigenvectors."""

from time import process_time

import numpy as np
import pytest
from scipy.fft import idctn

from mapmaker.cleaning import PcaOptions, TemplateOptions, clean, pca
from mapmaker.cleaning.pca import count_outliers, min_eigenvalues
from mapmaker.timestreams import FocalPlane
from surveysim.runtime.memory import peak_bytes
from tests import naive

OPTIONS = PcaOptions(3.0)


def _focal_plane(n_det):
    x, y = np.random.default_rng(0).uniform(-1e-3, 1e-3, (2, n_det))
    return FocalPlane(x_rad=x, y_rad=y, fwhm_rad=1.5e-4)


def _modes(singular, n_det, n_samp, seed=0):
    """Orthonormal modes of detectors (n_det, k) and of samples (k, n_samp), these mean-free, and their matrix."""
    rng = np.random.default_rng(seed)
    k = len(singular)
    left = np.linalg.qr(rng.standard_normal((n_det, k)))[0]
    template = rng.standard_normal((n_samp, k))
    right = np.linalg.qr(template - template.mean(axis=0))[0].T
    return left, right, (left * singular) @ right


def _clean(data):
    return clean("pca", data, np.array([[0, data.shape[1]]]), _focal_plane(len(data)), options=OPTIONS)


@pytest.mark.parametrize("n_samp", [20, 39, 40, 41, 150])
@pytest.mark.parametrize("seed", range(4))
def test_equals_the_paper_s_steps(seed, n_samp):
    rng = np.random.default_rng(seed)
    common = np.array([[30], [5]]) * rng.standard_normal((2, n_samp))
    data = rng.standard_normal((40, 2)) @ common + rng.standard_normal((40, n_samp))
    cleaned = _clean(data)
    expected, n_modes = naive.pca_cleaning(data, 3.0)
    assert cleaned.removed[0] == n_modes
    np.testing.assert_allclose(cleaned.data_mk, expected, atol=1e-11)


@pytest.mark.parametrize(("n_det", "n_samp"), [(60, 150), (60, 41)])
@pytest.mark.parametrize(("dtype", "level"), [(np.float64, 1e-10), (np.float32, 1e-4)])
def test_planted_modes_vanish_and_the_rest_stays(n_det, n_samp, dtype, level):
    """38 logarithms of eigenvalues from -1 to 1, and 4 and 14: 4 stands out only when 14 is gone.

    The 20 directions without power are not to count as small eigenvalues.
    float32: its rounding of the strongest mode, whose values are 100 or so.
    """
    singular = np.exp(np.concatenate([np.linspace(-0.5, 0.5, 38), [2, 7]]))
    logarithm = 2 * np.log(singular)
    assert logarithm[38] < logarithm.mean() + 3 * logarithm.std() < logarithm[39]
    left, right, data = _modes(singular, n_det, n_samp)
    cleaned = _clean(data.astype(dtype))
    rest = (left[:, :38] * singular[:38]) @ right[:38]
    assert cleaned.data_mk.dtype == dtype and cleaned.removed[0] == 2
    np.testing.assert_allclose(cleaned.data_mk, rest, atol=level)
    np.testing.assert_array_equal(cleaned.responsivity, 1)
    np.testing.assert_array_equal(cleaned.iterations, 0)


def test_equal_eigenvalues_are_cut_together_or_not_at_all():
    rng = np.random.default_rng(1)
    _, _, flat = _modes(np.ones(30), 30, 100)
    assert _clean(flat).removed[0] == 0
    np.testing.assert_allclose(_clean(flat).data_mk, flat, atol=1e-14)
    singular = np.concatenate([np.exp(0.1 * rng.standard_normal(30)), [1e3, 1e3]])
    left, right, data = _modes(singular, 32, 100)
    cleaned = _clean(data)
    assert cleaned.removed[0] == 2
    np.testing.assert_allclose(cleaned.data_mk, (left[:, :30] * singular[:30]) @ right[:30], atol=1e-10)


def test_rounding_of_equal_eigenvalues_does_not_stand_out():
    assert count_outliers(np.concatenate([np.ones(40), [1 + 1e-12]]), 3.0) == 0


def test_low_eigenvalues_are_never_cut():
    assert count_outliers(np.exp(np.concatenate([[-20.0], np.linspace(-0.1, 0.1, 50)])), 3.0) == 0


@pytest.mark.parametrize("sigma_cut", [0.5, 1.3, 2.2, 3.1, 4.5])
def test_least_number_of_which_one_can_stand_out(sigma_cut):
    n = min_eigenvalues(sigma_cut)
    one = np.exp(np.concatenate([np.zeros(n), [5.0]]))
    assert count_outliers(one[1:], sigma_cut) == 1
    assert count_outliers(one[2:], sigma_cut) == 0
    assert min_eigenvalues(3.0) == 11


def test_too_few_samples_for_an_outlier_lose_their_mean_alone():
    """11 samples without their mean have 10 eigenvalues; 11 are needed."""
    data = 100 * np.random.default_rng(2).standard_normal(11) + np.random.default_rng(3).standard_normal((30, 11))
    cleaned = _clean(data)
    assert cleaned.kept.all() and cleaned.removed[0] == 0
    np.testing.assert_allclose(cleaned.data_mk, data - data.mean(axis=1, keepdims=True), atol=1e-12)


def _under(common, dtype):
    """White noise of 1 in 40 detectors under a common mode."""
    rng = np.random.default_rng(4)
    gain = 1 + 0.05 * rng.standard_normal((40, 1))
    return (rng.standard_normal((40, 150)) + common * gain * rng.standard_normal(150)).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_noise_far_below_the_atmosphere_is_noise(dtype):
    """Of 1e12 in power a Gram matrix loses the smallest eigenvalues, and float32 streams a thousandth of the noise."""
    weak, strong = _clean(_under(30.0, dtype)), _clean(_under(1e6, dtype))
    assert strong.kept.all() and strong.removed[0] == weak.removed[0] == 1
    assert strong.data_mk.std() == pytest.approx(weak.data_mk.std(), rel=3e-3)


def test_scan_whose_noise_is_lost_to_rounding_is_discarded():
    """Nothing would stand out of one eigenvalue, and the whole atmosphere stay."""
    assert not _clean(_under(1e10, np.float64)).kept.any()


def test_after_cleaning_in_float32_what_it_took_does_not_count():
    """Quadratic templates leave 34 of 40 directions; rounding in the others is no small eigenvalue."""
    plane, bounds = _focal_plane(40), np.array([[0, 150]])
    once = clean("quadratic", _under(30.0, np.float32), bounds, plane, options=TemplateOptions(1e-8, 100))
    assert once.kept.all()
    again = clean("pca", once.data_mk, bounds, plane, options=OPTIONS)
    assert again.kept.all() and again.removed[0] == 0


def test_too_few_detectors():
    with pytest.raises(ValueError, match="a cut at 3.0 sigma needs at least 11 detectors, got 10"):
        _clean(np.random.default_rng(0).standard_normal((10, 50)))


@pytest.mark.parametrize("sigma_cut", [0.0, -3.0, np.nan, np.inf])
def test_options_out_of_range(sigma_cut):
    with pytest.raises(
        ValueError, match="sigma_cut: found .*; a finite number above 0 and of at most 1000000 is expected"
    ):
        PcaOptions(sigma_cut)


def _planted(singular, n_det, n_samp):
    """Streams with known singular values: cosines of detectors times cosines of samples, these without a mean."""
    coefficients = np.zeros((n_det, n_samp))
    np.fill_diagonal(coefficients[:, 1:], singular)
    return idctn(coefficients, norm="ortho", overwrite_x=True)


@pytest.mark.parametrize(("n_det", "n_samp"), [(120, 200), (120, 121), (121, 121), (200, 121)])
@pytest.mark.parametrize("n_empty", [0, 7])
@pytest.mark.parametrize("strongest", [7.0, 16.0])
def test_large_matrices_lose_the_planted_modes(monkeypatch, n_det, n_samp, n_empty, strongest):
    """As small ones, with and without directions that earlier cleaning emptied, and eigenvalues up to 1e14 apart."""
    monkeypatch.setattr(pca, "MOST_DENSE", 100)
    rank = min(n_det, n_samp - 1) - n_empty
    bulk = np.exp(np.linspace(-0.5, 0.5, rank - 3))
    singular = np.concatenate([[np.exp(strongest), np.exp(strongest / 2), np.exp(2)], bulk, np.zeros(n_empty)])
    cleaned = _clean(_planted(singular, n_det, n_samp))
    singular[:3] = 0
    assert cleaned.kept.all() and cleaned.removed[0] == 3
    # The rounding of the Gram matrix, 1e-16 of the largest eigenvalue.
    level = 1e-12 + 1e-16 * np.exp(2 * strongest)
    np.testing.assert_allclose(cleaned.data_mk, _planted(singular, n_det, n_samp), atol=level)


@pytest.mark.parametrize(("n_det", "n_samp"), [(300, 360), (300, 300), (360, 300)])
@pytest.mark.parametrize("level", [0.0, 3.0, 1e4])
@pytest.mark.parametrize("cleaned_before", [False, True])
def test_large_matrices_agree_with_the_dense_solver(monkeypatch, n_det, n_samp, level, cleaned_before):
    rng = np.random.default_rng(5)
    modes = rng.standard_normal((n_det, 6)) * 10.0 ** -np.arange(6)
    data = rng.standard_normal((n_det, n_samp)) + level * modes @ rng.standard_normal((6, n_samp))
    if cleaned_before:
        templates = np.linalg.qr(rng.standard_normal((n_det, 5)))[0]
        data -= templates @ (templates.T @ data)
    dense = _clean(data)
    monkeypatch.setattr(pca, "MOST_DENSE", 100)
    found = _clean(data)
    assert found.kept.all() and found.removed[0] == dense.removed[0]
    np.testing.assert_allclose(found.data_mk, dense.data_mk, atol=1e-11 + 1e-14 * level**2)


def test_large_matrices_have_all_eigenvalues():
    """To the rounding of the streams, 1e-16 of the strongest mode; eigenvalues that are rounding are 0."""
    singular = np.concatenate([[1e6, 1e5, 1e3], np.linspace(2, 1, 200), np.zeros(17)])
    block = _planted(singular, 220, 300)
    eigenvalues, leading = pca._large_spectrum(block, True)
    np.testing.assert_allclose(eigenvalues[::-1], singular**2, rtol=1e-10, atol=0)
    np.testing.assert_allclose(leading(220).T @ leading(220), np.eye(220), atol=1e-12)
    assert leading(0).shape == (220, 0)


def test_large_scan_whose_noise_is_lost_to_rounding_is_discarded(monkeypatch):
    monkeypatch.setattr(pca, "MOST_DENSE", 30)
    assert not _clean(_under(1e10, np.float64)).kept.any()
    assert _clean(_under(1e5, np.float64)).removed[0] == 1


@pytest.mark.slow
def test_memory_of_many_detectors(monkeypatch):
    """Half as many again as have all their eigenvectors computed, with directions that earlier cleaning emptied."""
    monkeypatch.setattr(pca, "MOST_DENSE", 2000)
    n_det, n_samp = 3000, 3200
    singular = np.concatenate([np.exp([8, 4, 2]), np.exp(np.linspace(-0.5, 0.5, n_det - 9)), np.zeros(6)])
    data = _planted(singular, n_det, n_samp).astype(np.float32)
    before, start = peak_bytes(), process_time()
    cleaned = _clean(data)
    assert process_time() - start < 300 / 8  # of 6000, in five minutes
    # Streams in float64 and without their strongest modes, results, and three matrices of pairs.
    assert peak_bytes() - before < 1.2 * (8 * (2 * data.size + 3 * n_det**2) + 4 * data.size)
    assert cleaned.kept.all() and cleaned.removed[0] == 3
    singular[:3] = 0
    np.testing.assert_allclose(cleaned.data_mk, _planted(singular, n_det, n_samp), atol=1e-6)


def _gram_spectrum(data):
    block = data - data.mean(axis=1, keepdims=True)
    return np.linalg.eigh(block @ block.T)


def _white_under_modes(n_mode, n_det=60, n_samp=400, seed=8):
    rng = np.random.default_rng(seed)
    strong = rng.standard_normal((n_det, n_mode)) @ (3 * rng.standard_normal((n_mode, n_samp)))
    return strong + rng.standard_normal((n_det, n_samp))


@pytest.mark.parametrize(
    "options", [PcaOptions(criterion="modes", modes=3), PcaOptions(criterion="variance", variance=0.9)]
)
def test_leading_modes_are_projected_out(options):
    """A fixed number, or the fewest with a share of the variance, by the eigenvectors of the covariance."""
    data = _white_under_modes(5)
    values, vectors = _gram_spectrum(data)
    held = np.cumsum(values[::-1]) / values.sum()
    n_modes = 3 if options.modes else 1 + np.argmax(held >= 0.9)
    assert n_modes == (3 if options.modes else 5)
    leading = vectors[:, -n_modes:]
    block = data - data.mean(axis=1, keepdims=True)
    cleaned = clean("pca", data, np.array([[0, 400]]), _focal_plane(60), options=options)
    np.testing.assert_allclose(cleaned.data_mk, block - leading @ (leading.T @ block), atol=1e-11)
    assert cleaned.removed[0] == n_modes


@pytest.mark.parametrize(("n_det", "n_samp"), [(60, 400), (150, 100)])
@pytest.mark.parametrize("n_mode", [0, 1, 6])
def test_marchenko_pastur_finds_the_planted_modes(n_det, n_samp, n_mode):
    """White noise alone exceeds the edge in 17 % of the draws (Tracy & Widom 1996): in 3.4 +- 1.7 of 20."""
    options, bounds, plane = PcaOptions(criterion="marchenko_pastur"), np.array([[0, n_samp]]), _focal_plane(n_det)
    counts = [
        clean("pca", _white_under_modes(n_mode, n_det, n_samp, seed), bounds, plane, options=options).removed[0]
        - n_mode
        for seed in range(20)
    ]
    assert min(counts) >= 0 and sum(counts) <= 10


def test_marchenko_pastur_edge_is_that_of_its_law():
    """An eigenvalue just below the edge of the others stays, one just above goes."""
    n_det, n_samp = 50, 200
    rest = np.full(n_det - 1, 1.0)
    edge = (1 + np.sqrt(n_det / n_samp)) ** 2
    alone = edge * (n_det - 1) / (n_det - edge)  # x = edge (x + n_det - 1) / n_det
    options = PcaOptions(criterion="marchenko_pastur")
    counts = [
        pca.count_modes(np.append(rest, factor * alone), options, n_det=n_det, n_samp=n_samp)
        for factor in (0.999, 1.001)
    ]
    assert counts == [0, 1]


def test_criteria_count_after_templates_too():
    """Earlier cleaning leaves fewer dimensions: white noise less its quadratic templates has no mode above the edge."""
    plane, bounds = _focal_plane(60), np.array([[0, 400]])
    once = clean(
        "quadratic", 30 + _white_under_modes(0), bounds, plane, options=TemplateOptions(1e-8, 100, np.ones(60))
    )
    again = clean("pca", once.data_mk, bounds, plane, options=PcaOptions(criterion="marchenko_pastur"))
    assert again.kept.all() and again.removed[0] <= 1
    assert clean("pca", once.data_mk, bounds, plane, options=PcaOptions(criterion="modes", modes=53)).kept.all()
    assert not clean("pca", once.data_mk, bounds, plane, options=PcaOptions(criterion="modes", modes=54)).kept.any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"criterion": "kaiser"}, "criterion: found 'kaiser'; one of 'sigma_cut', 'modes', 'variance', "),
        ({"criterion": "modes"}, "modes: found None; an integer of at least 1 is expected"),
        ({"criterion": "modes", "modes": 0}, "modes: found 0; an integer of at least 1 is expected"),
        ({"criterion": "variance", "variance": 1.0}, "variance: found 1.0; a finite number above 0 and below 1"),
        ({"sigma_cut": 3.0, "modes": 2}, "modes: found a value with criterion 'sigma_cut'; None is expected"),
    ],
)
def test_criteria_out_of_range(options, message):
    with pytest.raises(ValueError, match=message):
        PcaOptions(**options)
