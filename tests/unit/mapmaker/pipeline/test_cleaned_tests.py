"""Tests of cleaned streams: jumps and glitches are found where they are, noise and sources are not."""

import numpy as np
import pytest

from mapmaker.kernels.cleaned_tests import step_statistic
from mapmaker.pipeline.cleaned_tests import CleanedBlock, find_glitches, find_jumps, mean_square, white_noise
from mapmaker.pipeline.common_signal import compare_with_others, strangers
from tests import naive

N_DET, N, BOUNDS = 12, 200, np.array([[0, 200], [210, 410], [420, 500]])
N_SAMP, WINDOW = 510, 20


def block(seed=0, change=lambda data: None, lost=None, place=None):
    data = np.random.default_rng(seed).standard_normal((N_DET, N_SAMP))
    change(data)
    nothing = np.zeros(data.shape, bool)
    places = np.full(data.shape, -1) if place is None else place
    return CleanedBlock(
        data, nothing if lost is None else lost, BOUNDS, nothing.__getitem__, places.__getitem__, places.max() + 1
    )


def test_step_statistic():
    rng = np.random.default_rng(1)
    data, lost = rng.standard_normal((3, N_SAMP)), rng.random((3, N_SAMP)) < 0.3
    found = step_statistic(data, lost, BOUNDS, WINDOW, 4)
    np.testing.assert_allclose(found, naive.step_statistic(data, lost, BOUNDS, WINDOW, 4), atol=1e-5)
    white = step_statistic(rng.standard_normal((200, N_SAMP)), np.zeros((200, N_SAMP), bool), BOUNDS, WINDOW, 4)
    # 200 detectors of 24 independent windows: the scatter of a variance is 0.02.
    assert np.mean(white[:, 20:180] ** 2) == pytest.approx(1, abs=0.08)


@pytest.mark.parametrize("seed", range(4))
def test_noise_alone_has_neither(seed):
    assert find_jumps(block(seed), WINDOW, 8.0) == {} and not find_glitches(block(seed), 6.0).any()


@pytest.mark.parametrize("place", [6, 100, 193])
def test_a_jump_is_found_and_nothing_else(place):
    def jump(data):
        data[4, 210 + place : 410] += 15.0
        data -= np.where(np.arange(N_SAMP) >= 210 + place, 1.0, 0.0)  # what cleaning leaves in the others
        data[7, 300] += 50.0  # a glitch is none

    found = find_jumps(block(2, jump), WINDOW, 8.0)
    assert list(found) == [(4, 1)] and float(found[4, 1].split()[0]) == pytest.approx(15, abs=2)


def test_what_all_detectors_do_is_no_jump():
    def weather(data):
        data[:, 300:410] += np.linspace(-20, 20, N_DET)[:, None]

    assert find_jumps(block(3, weather), WINDOW, 8.0) == {}


def test_glitches_with_their_neighbours():
    def glitches(data):
        data[2, [50, 405]] += [40.0, -30.0]
        data[:, 205] += 100.0  # outside scans
        data[:, 50] -= 2.0  # what cleaning leaves in the others

    found = find_glitches(block(4, glitches), 6.0)
    expected = np.zeros(found.shape, bool)
    expected[2, [49, 50, 51, 404, 405, 406]] = True
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("passes, is_source", [(12, True), (1, False)])
def test_what_several_passes_see_is_a_source(passes, is_source):
    """A source of 20 sigma, in as many detectors and in 15 samples of the first scan."""
    place = np.full((N_DET, N_SAMP), -1)
    place[:, 100:115] = 7

    def source(data):
        data[:passes, 100:115] += 20.0

    item = block(5, source, place=place)
    assert find_glitches(item, 6.0).any() != is_source
    assert bool(find_jumps(item, 10, 8.0)) != is_source


@pytest.mark.parametrize("drift", [0.0, 1.0])
def test_detectors_without_the_common_signal(drift):
    """Found beside a common drift, though others have twice the gain or much noise; never in noise alone."""
    for seed in range(50):
        rng = np.random.default_rng(seed)
        walk = np.cumsum(rng.standard_normal(N_SAMP))
        data = rng.standard_normal((N_DET + 2, N_SAMP)) + drift * walk
        data[4] += drift * walk
        data[6] += 20 * drift * rng.standard_normal(N_SAMP)
        data[9] = rng.standard_normal(N_SAMP)
        lost = rng.random(data.shape) < 0.05
        data[lost] = np.nan
        found = strangers(*compare_with_others(data, lost, BOUNDS, np.arange(len(data))))
        assert np.flatnonzero(found).tolist() == [9] * (drift > 0)


def test_a_planet_in_some_scans_hides_no_common_signal():
    for seed in range(50):
        rng = np.random.default_rng(seed)
        bounds = np.array([[start, start + 600] for start in range(0, 6000, 600)])
        data = rng.standard_normal((40, 6000)) + 0.1 * np.cumsum(rng.standard_normal(6000))
        for row in data[:10]:
            for start in (1800, 2400):
                at = start + rng.integers(50, 500)
                row[at : at + 7] += 1e4
        found = compare_with_others(data, np.zeros(data.shape, bool), bounds, np.arange(40))
        assert not strangers(*found).any()


def test_noise_levels():
    rng = np.random.default_rng(6)
    data, lost = 3.0 * rng.standard_normal((40, 5000)), rng.random((40, 5000)) < 0.1
    data[lost] = 1e6
    bounds = np.array([[0, 2500], [2500, 5000]])
    slow = 2.0 * np.sin(np.arange(5000) / 300)
    assert white_noise(data + slow, lost, bounds) == pytest.approx(3, rel=0.08)  # 5 sigma of 4000 differences
    assert mean_square(data + slow, lost, bounds) == pytest.approx(9 + np.mean(slow**2), rel=0.12)
