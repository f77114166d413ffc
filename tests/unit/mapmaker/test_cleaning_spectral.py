"""The spectral common mode: what other bands see of the same layer goes, the band's own stays."""

import numpy as np
import pytest

from mapmaker.cleaning import SpectralOptions, clean
from mapmaker.timestreams import FocalPlane

BOUNDS = np.array([[0, 300], [310, 610]])
N_DET, N_SAMP = 5, 620


def focal_plane():
    return FocalPlane(np.arange(N_DET) * 1e-4, np.zeros(N_DET), 3e-4)


def streams(seed=1, noise=0.0):
    """The mapped band and two others: one layer a detector, times gains, and noise."""
    rng = np.random.default_rng(seed)
    layer = np.cumsum(rng.standard_normal((N_DET, N_SAMP)), axis=1)
    gains = rng.uniform(0.5, 8, (3, N_DET, 1))
    bands = gains * layer + noise * rng.standard_normal((3, N_DET, N_SAMP))
    return bands[0], bands[1:]


def test_a_layer_that_all_bands_see_goes_entirely():
    data, others = streams()
    cleaned = clean("spectral", data, BOUNDS, focal_plane(), options=SpectralOptions(others[:1]))
    assert cleaned.kept.all() and cleaned.removed.tolist() == [1, 1]
    for start, stop in BOUNDS:
        assert np.abs(cleaned.data_mk[:, start:stop]).max() < 1e-9 * np.abs(data).max()


def test_what_is_left_is_orthogonal_to_the_other_bands():
    data, others = streams(noise=1.0)
    cleaned = clean("spectral", data, BOUNDS, focal_plane(), options=SpectralOptions(others))
    for start, stop in BOUNDS:
        left, seen = cleaned.data_mk[:, start:stop], others[:, :, start:stop]
        seen = seen - seen.mean(axis=2, keepdims=True)
        product = np.einsum("it,cit->ci", left, seen)
        assert np.abs(product).max() < 1e-8 * np.abs(np.einsum("it,cit->ci", data[:, start:stop], seen)).max()


def test_the_least_squares_fit_of_each_detector_by_itself():
    data, others = streams(noise=1.0)
    cleaned = clean("spectral", data, BOUNDS, focal_plane(), options=SpectralOptions(others))
    start, stop = BOUNDS[1]
    for i in range(N_DET):
        own = data[i, start:stop] - data[i, start:stop].mean()
        basis = (others[:, i, start:stop] - others[:, i, start:stop].mean(axis=1, keepdims=True)).T
        expected = own - basis @ np.linalg.lstsq(basis, own, rcond=None)[0]
        np.testing.assert_allclose(cleaned.data_mk[i, start:stop], expected, atol=1e-9 * np.abs(own).max())


def test_white_noise_loses_one_degree_of_freedom_a_band():
    """Of 300 samples, less their mean, two bands take two: variance falls by 2 / 299, to 5 sqrt(2 / N)."""
    rng = np.random.default_rng(2)
    data, others = rng.standard_normal((N_DET, N_SAMP)), rng.standard_normal((2, N_DET, N_SAMP))
    cleaned = clean("spectral", data, BOUNDS, focal_plane(), options=SpectralOptions(others))
    ratio = []
    for start, stop in BOUNDS:
        ratio.append(
            (cleaned.data_mk[:, start:stop] ** 2).sum() / (299 * data[:, start:stop].var(axis=1, ddof=1)).sum()
        )
    # The share that is lost is itself random, sqrt(2 * 2) / 299 a stream.
    assert np.mean(ratio) == pytest.approx(1 - 2 / 299, abs=5 * 2 / 299 / np.sqrt(2 * N_DET))


def test_a_scan_with_a_broken_band_is_discarded():
    data, others = streams(noise=1.0)
    others[1, 2, 350] = np.nan
    cleaned = clean("spectral", data, BOUNDS, focal_plane(), options=SpectralOptions(others))
    assert cleaned.kept.tolist() == [True, False] and not cleaned.data_mk[:, 310:610].any()


def test_a_scan_that_another_band_has_lost_is_discarded():
    """A scan of zeros, as cleaning leaves one that it discards, says nothing of the atmosphere."""
    data, others = streams(noise=1.0)
    others[0, :, 310:610] = 0
    cleaned = clean("spectral", data, BOUNDS, focal_plane(), options=SpectralOptions(others))
    assert cleaned.kept.tolist() == [True, False]


def test_errors():
    data, others = streams()
    with pytest.raises(ValueError, match=r"\(n_band, n_det, n_samp\) is expected"):
        SpectralOptions(others[0])
    with pytest.raises(ValueError, match=r"\(n_band, 5, 620\) is expected"):
        clean("spectral", data, BOUNDS, focal_plane(), options=SpectralOptions(others[:, :4]))
    with pytest.raises(ValueError, match="2 other bands need scans of 3 samples, got 2"):
        clean("spectral", data, np.array([[0, 2]]), focal_plane(), options=SpectralOptions(others))
