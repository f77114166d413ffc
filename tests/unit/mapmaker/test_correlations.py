"""Pairs by separation, covariances of scans, and a profile that gains do not touch."""

import math

import numpy as np
import pytest

from mapmaker.correlations import correlation_profile, pair_bins, scan_covariances
from mapmaker.timestreams import FocalPlane
from surveysim.telescope.layouts import hexagon

PITCH = math.radians(40 / 3600)
BOUNDS = np.array([[0, 40], [45, 85], [85, 125]])


def plane(rings=3):
    x, y = hexagon(rings, PITCH).T
    return FocalPlane(x, y, 3e-4)


def planted(focal_plane, shape):
    """C_ij = g_i g_j p(separation) for every scan, scan s scaled by s + 1; gains within 20 %."""
    gain = np.random.default_rng(5).uniform(0.8, 1.2, len(focal_plane.x_rad))
    apart = np.hypot(*(np.subtract.outer(axis, axis) for axis in (focal_plane.x_rad, focal_plane.y_rad)))
    return np.array([1.0, 2.0, 3.0])[:, None, None] * gain[:, None] * gain * shape(apart), gain


def test_pairs_of_a_hexagon():
    bins = pair_bins(plane(1))  # a centre and six around it
    assert len(bins.bin) == 21 and bins.adjacent.sum() == 12
    # Six pairs sqrt(3) pitches apart and three across the centre share the only bin.
    assert bins.count.tolist() == [9]
    assert bins.theta_rad[0] == pytest.approx(PITCH * math.sqrt((6 * 3 + 3 * 4) / 9), rel=1e-12)
    separations = np.sort(bins.separation_rad) / PITCH
    np.testing.assert_allclose(separations, [1] * 12 + [math.sqrt(3)] * 6 + [2] * 3, rtol=1e-12)


def test_means_of_bins():
    bins = pair_bins(plane(2))
    means = bins.mean(bins.separation_rad**2)
    np.testing.assert_allclose(np.sqrt(means), bins.theta_rad, rtol=1e-12)


def test_covariance_of_a_scan_is_the_mean_product_about_its_mean():
    data = np.random.default_rng(1).standard_normal((3, 130)) + 7
    found = scan_covariances(data, BOUNDS)
    for s, (start, stop) in enumerate(BOUNDS):
        np.testing.assert_allclose(found[s], np.cov(data[:, start:stop], bias=True), rtol=1e-12)


def test_profile_is_free_of_gains():
    focal_plane = plane()
    bins = pair_bins(focal_plane)
    # Constant within bins, so that the answer is exact.
    levels = np.array([9.0, 1.00, 0.99, 0.96, 0.94, 0.90, 0.85])[: len(bins.count) + 1]
    number = np.full((37, 37), -1)
    number[bins.first, bins.second] = number[bins.second, bins.first] = bins.bin
    covariances, gain = planted(focal_plane, lambda apart: levels[number + 1])
    profile = correlation_profile(covariances, bins)
    expected = np.log(levels[1:])
    np.testing.assert_allclose(profile.log_profile, expected - expected.mean(), atol=1e-12)
    assert np.ptp(profile.scan_profiles, axis=0).max() < 1e-12
    distant = ~bins.adjacent
    logs = np.log(covariances.mean(axis=0)[bins.first, bins.second][distant])
    assert profile.log_level == pytest.approx(logs.mean(), rel=1e-12)
    assert profile.adjacent_mk2 == pytest.approx(
        np.mean(2 * 9.0 * (gain[bins.first] * gain[bins.second])[bins.adjacent]), rel=1e-12
    )


def test_gains_alone_would_look_like_a_profile():
    """The plain means of bins follow the gains: what the profile is for."""
    focal_plane = plane()
    bins = pair_bins(focal_plane)
    covariances, _ = planted(focal_plane, np.ones_like)
    profile = correlation_profile(covariances, bins)
    assert np.ptp(profile.log_profile) < 1e-12 < 1e-3 < np.ptp(np.log(profile.covariance_mk2))


def test_one_scan_left_out():
    bins = pair_bins(plane())
    covariances = np.random.default_rng(2).uniform(0.9, 1.1, (3, 37, 37))
    profile = correlation_profile(covariances, bins)
    for s in range(3):
        rest = correlation_profile(np.delete(covariances, s, axis=0), bins)
        np.testing.assert_allclose(profile.scan_profiles[s], rest.log_profile, rtol=1e-9, atol=1e-12)


def test_no_common_signal_gives_no_profile():
    bins = pair_bins(plane())
    noise = np.random.default_rng(3).standard_normal((37, 125))
    profile = correlation_profile(scan_covariances(noise, BOUNDS), bins)
    assert np.isnan(profile.log_profile).all() and math.isnan(profile.log_level)
    assert np.isfinite(profile.covariance_mk2).all()


@pytest.mark.parametrize(
    "x, y, words",
    [
        ([0.0, 1.0], [0.0, 0.0], "found 2 detectors; 3 or more"),
        ([0.0, 1.0, 0.5], [0.0, 0.0, 0.8], "adjacent pairs of detectors only"),
        ([0.0, 1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 0.0], "can't tell correlations from gains"),
    ],
)
def test_arrays_that_will_not_do(x, y, words):
    with pytest.raises(ValueError, match=words):
        pair_bins(FocalPlane(np.array(x), np.array(y), 1.0))
