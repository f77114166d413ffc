"""White levels and modes of bands: from few vectors, the model weighs a sky nearly as the true covariance does."""

import numpy as np
import pytest

from mapmaker.noise_modes import band_noise

N_DET = 61
ROW, COLUMN = np.indices((9, 9)) - 4
INSIDE = np.abs(ROW + COLUMN) <= 4
PLACE = np.column_stack([(COLUMN + ROW / 2)[INSIDE], ROW[INSIDE] * 0.866])
SEPARATION = np.hypot(*(PLACE[:, None] - PLACE).transpose(2, 0, 1))


def atmosphere(gain):
    """Covariance of a structure function r^5/3 under a common mode, seen with gains, and white noise of 0.5 to 2."""
    smooth = 1000 - SEPARATION ** (5 / 3)
    return gain[:, None] * smooth * gain + np.diag(np.linspace(0.5, 2, N_DET))


def measured(rng, covariance, n):
    """Covariance measured with n vectors."""
    vectors = np.linalg.cholesky(covariance) @ rng.standard_normal((len(covariance), n))
    return vectors @ vectors.T / n


def modelled(covariances, n, **limits):
    limits = {"max_modes": 20, "eigenvalue_cut": 2.0} | limits
    return band_noise(np.array(covariances), np.array(n), PLACE[: len(covariances[0])], **limits)


def inverses(found):
    return [np.linalg.inv(np.diag(w) + v @ v.T) for w, v in zip(found.white_mk2, found.modes_mk, strict=True)]


def excess(covariance, inverse, gain):
    """Mean noise of waves over the array with these weights, over the least possible (Gauss and Markov)."""
    waves = np.array([gain * np.cos(PLACE @ wave + 1) for wave in ((0.3, 0), (0, 0.6), (0.7, 0.7), (1.2, -0.5))])
    noise = [(s @ inverse @ covariance @ inverse @ s) / (s @ inverse @ s) ** 2 for s in waves]
    return np.mean([a * (s @ np.linalg.solve(covariance, s)) for a, s in zip(noise, waves, strict=True)])


def test_few_vectors_are_enough_for_smooth_noise():
    """30 vectors of 61 detectors with gains of 5 % rms, as those of 15 scans below 0.1 Hz.

    The covariance itself has no inverse; of modes found in the data the excess is 1.5.
    """
    rng = np.random.default_rng(1)
    gain = 1 + 0.05 * rng.standard_normal(N_DET)
    low, high = atmosphere(gain), atmosphere(0.1 * gain)
    ratios = []
    for _ in range(8):
        found = modelled([measured(rng, low, 30), measured(rng, high, 300)], [30, 300])
        ratios.append([excess(c, w, gain) for c, w in zip((low, high), inverses(found), strict=True)])
        assert found.n_found == (0, 0)
    assert (np.mean(ratios, axis=0) < 1.2).all()


def test_a_pattern_that_is_not_smooth_is_found():
    """Detectors in turn have the other sign, with the mean power of their white noise and more."""
    rng, sign = np.random.default_rng(2), (-1.0) ** np.arange(N_DET)
    truth = atmosphere(np.ones(N_DET)) + 2 * np.outer(sign, sign)
    found = modelled([measured(rng, truth, 2000)], [2000])
    assert found.n_found == (1,)
    assert excess(truth, inverses(found)[0], np.ones(N_DET)) < 1.15
    assert sign @ inverses(found)[0] @ sign == pytest.approx(sign @ np.linalg.solve(truth, sign), rel=0.1)


def test_white_noise_has_no_modes():
    """Levels of detectors are known to sqrt(2 / 4000), in the ratio of 1 to 3 of both bands."""
    rng, level = np.random.default_rng(3), np.linspace(0.5, 2, N_DET)
    found = modelled([measured(rng, np.diag(level), 1000), measured(rng, np.diag(3 * level), 3000)], [1000, 3000])
    assert [item.shape[1] for item in found.modes_mk] == [0, 0]
    np.testing.assert_allclose(found.white_mk2, [level, 3 * level], rtol=5 * np.sqrt(2 / 4000))


@pytest.mark.parametrize(("max_modes", "n_mode"), [(0, 0), (2, 2), (3, 3), (9, 6), (20, 10)])
def test_smooth_modes_are_of_whole_degrees(max_modes, n_mode):
    """1, 3, 6 and 10 shapes up to the degrees 0 to 3; what these leave of the atmosphere may be found besides."""
    found = modelled([1e3 * atmosphere(np.ones(N_DET))], [1000], max_modes=max_modes)
    smooth = found.modes_mk[0].shape[1] - found.n_found[0]
    assert smooth in (0, 1, 3, 6, 10) and smooth <= max_modes
    assert found.modes_mk[0].shape[1] == n_mode
