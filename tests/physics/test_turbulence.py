"""Correlation between detectors: theory against its definition and against realizations, and the fits of both."""

import math
from itertools import product

import numpy as np
import pytest

from mapmaker.correlations import Profile, correlation_profile, pair_bins, scan_covariances
from mapmaker.timestreams import FocalPlane
from surveysim.atmosphere.detector_correlation import OUTER_SCALE_M, correlation_grid, scan_correlation
from surveysim.atmosphere.screen_simulation import StripCache, add_atmosphere, strip_step
from surveysim.atmosphere.thin_screen import (
    Screen,
    at_elevation,
    beam_transfer,
    mean_removed_variance,
    structure_function,
)
from surveysim.atmosphere.turbulence_fit import HEIGHT_GRID_M, INDEX_GRID, KOLMOGOROV, TRACKS_RAD, fit_turbulence
from surveysim.telescope.illumination import UNIFORM
from surveysim.telescope.layouts import hexagon
from tests.deviates import deviates

ARCMIN = math.radians(1 / 60)
WIND, SECONDS, N_SAMP = 31 * ARCMIN, 15.0, 150
TRACK = WIND * SECONDS
N_SCAN = 20_000
LOWEST, ZENITH = math.radians(40), math.pi / 2


def screen(index, height):
    return Screen(index, 8 / height, OUTER_SCALE_M / height if index >= 4 else math.inf)


def focal_plane():
    """37 detectors over 8 arcmin."""
    x, y = hexagon(3, 80 / 60 * ARCMIN).T
    return FocalPlane(x, y, 3e-4)


@pytest.fixture(scope="module")
def grid():
    bins = pair_bins(focal_plane())
    return bins, correlation_grid(
        bins.theta_rad,
        index=INDEX_GRID,
        height_m=HEIGHT_GRID_M,
        aperture_m=8.0,
        outer_scale_m=None,
        track_rad=TRACKS_RAD,
        lowest_rad=LOWEST,
    )


@pytest.mark.parametrize("index", [2 / 3, 2.0, 11 / 3, 14 / 3])
def test_of_one_detector_is_the_variance_about_the_mean(index):
    layer = screen(index, 1000.0)
    variance = mean_removed_variance(layer, WIND, SECONDS)
    assert scan_correlation(layer, np.zeros(1), TRACK)[0] == pytest.approx(variance, rel=1e-4)


@pytest.mark.parametrize("index, height", [(8 / 3, 1000.0), (11 / 3, 375.0), (11 / 3, 4000.0), (17 / 3, 1000.0)])
def test_is_the_double_sum_over_two_scans(index, height):
    """<(a - mean a)(b - mean b)> over all pairs of samples, averaged over directions of the pair."""
    layer, n = screen(index, height), 400
    lag = (np.arange(n)[:, None] - np.arange(n)) * TRACK / n
    for theta in (0.0, 2 * ARCMIN, 8 * ARCMIN):
        values = []
        for angle in (np.arange(6) + 0.5) * math.pi / 6:
            apart = np.hypot(theta * math.cos(angle) + lag, theta * math.sin(angle))
            values.append(0.5 * structure_function(layer, apart).mean() - 0.5 * structure_function(layer, theta))
        assert scan_correlation(layer, np.array([theta]), TRACK)[0] == pytest.approx(np.mean(values), rel=2e-4)


@pytest.mark.slow
def test_spline_in_the_track_is_the_quadrature(grid):
    """At any elevation: the beam is D sin(el) / h wide, and the amplitude B2 sin(el)^(1 - b)."""
    bins, table = grid
    for track, elevation in product((0.02, TRACK, 0.4), (ZENITH, math.pi / 4)):
        found, sine = table.correlation(np.array([track]), np.array([elevation])), math.sin(elevation)
        for i_b, i_h in ((2, 0), (KOLMOGOROV, 3), (KOLMOGOROV, 8), (10, 5)):
            layer = at_elevation(screen(INDEX_GRID[i_b], HEIGHT_GRID_M[i_h]), sine)
            expected = scan_correlation(layer, bins.theta_rad, track) * sine ** (1 - INDEX_GRID[i_b])
            np.testing.assert_allclose(found[i_b, i_h], expected, rtol=1e-3)
            shape = np.log(expected) - np.log(expected).mean()
            np.testing.assert_allclose(
                np.log(found[i_b, i_h]) - np.log(found[i_b, i_h]).mean(), shape, atol=0.003 * np.ptp(shape)
            )


def realizations(layer, n_scan, seed, amplitude=1.0, plane=None, closest_rad=0.0):
    """Streams (n_det, n_scan N_SAMP) of independent scans of the moving layer, and their bounds."""
    plane = plane or focal_plane()
    n_det = len(plane.x_rad)
    offsets = np.broadcast_to(np.stack([plane.x_rad, plane.y_rad], axis=-1), (n_scan, n_det, 2))
    angle = np.random.default_rng(seed).uniform(0, 2 * math.pi, n_scan)
    velocity = WIND * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    data = np.zeros((n_det, n_scan * N_SAMP), np.float32)
    bounds = N_SAMP * np.arange(n_scan)[:, None] + [0, N_SAMP]
    radius = float(np.hypot(plane.x_rad, plane.y_rad).max())
    strips = StripCache(layer, radius, strip_step(layer, closest_rad))
    add_atmosphere(
        data,
        bounds,
        sample_rate_hz=N_SAMP / SECONDS,
        offsets_rad=offsets,
        velocity_rad_s=np.zeros((n_scan, 2)),
        layer_velocity_rad_s=velocity,
        amplitude_mk=np.full(n_scan, amplitude),
        strips=strips,
        deviates=deviates(seed + 1),
    )
    return data, bounds


@pytest.mark.slow
@pytest.mark.parametrize(
    "index, height",
    [
        (13 / 6, 1000.0),
        (8 / 3, 1000.0),
        (11 / 3, 375.0),
        (11 / 3, 1000.0),
        (11 / 3, 2000.0),
        (14 / 3, 1000.0),
    ],
)
def test_theory_is_the_mean_of_realizations(index, height):
    """C(theta), and how far it falls below the first bin, within 3 % and the scatter of 20000 realizations."""
    layer, bins = screen(index, height), pair_bins(focal_plane())
    theory = scan_correlation(layer, bins.theta_rad, TRACK)
    means = []
    for block in range(N_SCAN // 200):
        data, bounds = realizations(layer, 200, 1000 + 2 * block)
        covariance = scan_covariances(data, bounds).mean(axis=0)
        means.append(bins.mean(covariance[bins.first, bins.second]))
    means = np.array(means)
    error = means.std(axis=0, ddof=1) / math.sqrt(len(means))
    assert (error < 0.012 * theory).all()
    np.testing.assert_array_less(np.abs(means.mean(axis=0) - theory), 0.03 * theory + 2 * error)
    # Within a strip the layer's roughness is drawn afresh, so the fall is known better than C itself.
    fall = means[:, :1] - means[:, 1:]
    error = fall.std(axis=0, ddof=1) / math.sqrt(len(fall))
    expected = theory[0] - theory[1:]
    np.testing.assert_array_less(np.abs(fall.mean(axis=0) - expected), 0.03 * expected + 2 * error)


@pytest.mark.slow
def test_wide_array_on_a_coarse_lattice():
    """Detectors 16 arcmin apart, beams of 1.5 m: the coarser lattice that they get leaves C(theta) as it should be."""
    x, y = hexagon(2, 16 * ARCMIN).T
    plane, layer = FocalPlane(x, y, 1e-3), Screen(11 / 3, 1.5e-3)
    bins = pair_bins(plane)
    assert strip_step(layer, 16 * ARCMIN) > 3 * strip_step(layer, 0.0)
    theory = scan_correlation(layer, bins.theta_rad, TRACK)
    means = []
    for block in range(20):
        data, bounds = realizations(layer, 200, 7 + 2 * block, plane=plane, closest_rad=16 * ARCMIN)
        covariance = scan_covariances(data, bounds).mean(axis=0)
        means.append(bins.mean(covariance[bins.first, bins.second]))
    means = np.array(means)
    fall = means[:, :1] - means[:, 1:]
    error = fall.std(axis=0, ddof=1) / math.sqrt(len(fall))
    np.testing.assert_array_less(
        np.abs(fall.mean(axis=0) - theory[0] + theory[1:]), 0.03 * (theory[0] - theory[1:]) + 2 * error
    )


def exact_profile(bins, theory, n_scan=18):
    """A profile without scatter but for jackknife samples that make every bin's error 1e-3."""
    shape = np.log(theory)
    spread = 1e-3 / math.sqrt(n_scan - 1) * np.resize([1.0, -1.0], n_scan)
    free = shape - shape.mean()
    level = float(shape @ bins.count / bins.count.sum())
    return Profile(theory, np.nan, free, free + spread[:, None], level)


@pytest.mark.slow
@pytest.mark.parametrize("i_b, i_h", [(4, 2), (KOLMOGOROV, 3), (8, 6)])
def test_an_exact_profile_gives_back_its_grid_point(grid, i_b, i_h):
    bins, table = grid
    elevation = np.full(18, math.radians(50))
    track = np.full(18, TRACK)
    theory = 280 * table.correlation(track, elevation)[i_b, i_h]
    fit = fit_turbulence(
        exact_profile(bins, theory), bins, table, track_rad=track, elevation_rad=elevation, overlap=None
    )
    assert fit.best == (i_b, i_h) and fit.chi2[fit.best] == pytest.approx(0, abs=1e-9)
    assert fit.b2[i_b, i_h] == pytest.approx(280, rel=1e-9)


def test_noise_shared_by_overlap_does_not_pass_for_turbulence(grid):
    bins, table = grid
    track, zenith = np.full(18, TRACK), np.full(18, ZENITH)
    theory = 280 * table.correlation(track, zenith)[KOLMOGOROV, 3]
    overlap = bins.mean(UNIFORM.aperture(bins.separation_rad / (57.14 / 60 * ARCMIN)))
    profile = exact_profile(bins, theory + 4.0 * overlap)
    plain = fit_turbulence(profile, bins, table, track_rad=track, elevation_rad=zenith, overlap=None)
    fit = fit_turbulence(profile, bins, table, track_rad=track, elevation_rad=zenith, overlap=overlap)
    # ln(C + e) is not quite ln C + e / C: the rest is a few per cent of the overlap's own pattern.
    assert fit.chi2[KOLMOGOROV, 3] < 0.01 * plain.chi2[KOLMOGOROV, 3]
    assert fit.best[0] == KOLMOGOROV


def test_what_can_not_be_fitted(grid):
    bins, table = grid
    zenith = np.full(3, math.pi / 2)
    nothing = np.full(len(bins.count), np.nan)
    blank = Profile(nothing, np.nan, nothing, np.tile(nothing, (3, 1)), np.nan)
    assert fit_turbulence(blank, bins, table, track_rad=np.full(3, TRACK), elevation_rad=zenith, overlap=None) is None
    profile = exact_profile(bins, table.correlation(np.full(3, TRACK), zenith)[KOLMOGOROV, 3], 3)
    for track in (np.nan, 0.0, 1e-5, 10.0):
        with np.errstate(divide="ignore"):
            assert (
                fit_turbulence(profile, bins, table, track_rad=np.full(3, track), elevation_rad=zenith, overlap=None)
                is None
            )


def test_a_scene_s_outer_scale_is_in_the_fit(grid):
    """Theory with an outer scale of 2 km, fitted with it and without: B2 comes back, or at half of it."""
    bins, table = grid
    zenith, track = np.full(18, math.pi / 2), np.full(18, TRACK)
    bounded = correlation_grid(
        bins.theta_rad, index=[11 / 3], height_m=[1000.0], aperture_m=8.0, outer_scale_m=2000.0, track_rad=TRACKS_RAD
    )
    theory = 280 * scan_correlation(Screen(11 / 3, 8e-3, 2.0), bins.theta_rad, TRACK)
    profile = exact_profile(bins, theory)
    assert fit_turbulence(profile, bins, bounded, track_rad=track, elevation_rad=zenith, overlap=None).b2[
        0, 0
    ] == pytest.approx(280, rel=1e-3)
    assert (
        0.4
        < fit_turbulence(profile, bins, table, track_rad=track, elevation_rad=zenith, overlap=None).b2[KOLMOGOROV, 3]
        / 280
        < 0.6
    )


@pytest.mark.parametrize("outer_scale, low, high", [(math.inf, 0.025, -0.007), (0.3, 0.13, -0.037)])
def test_what_a_wrong_height_does_to_b2(outer_scale, low, high):
    """Little, as most of a scan's variance is on scales far above the beam; more if an outer scale leaves them out."""
    right, lowest, highest = (
        mean_removed_variance(Screen(11 / 3, 8 / height, outer_scale), WIND, SECONDS) for height in (1000, 375, 6000)
    )
    assert right / lowest - 1 == pytest.approx(low, abs=0.005)
    assert right / highest - 1 == pytest.approx(high, abs=0.003)


def test_a_periodic_map_of_a_scan_s_length_has_the_paper_s_dependence_on_height():
    """Mean-removed variance summed over the modes of a box of 465 arcmin: B2 moves by +19 and -5 %, the paper's 15."""
    box = 465 * ARCMIN
    k = np.arange(-400, 401) / box
    k_x, k_y = np.meshgrid(k, k)
    alpha = np.hypot(k_x, k_y)
    alpha[alpha == 0] = np.inf
    kept = alpha ** (-11 / 3) * (1 - np.sinc(k_x * TRACK) ** 2)

    def variance(height):
        return np.sum(kept * beam_transfer(np.where(np.isfinite(alpha), alpha, 0) * 8 / height) ** 2)

    assert variance(1000) / variance(375) - 1 == pytest.approx(0.186, abs=0.01)
    assert variance(1000) / variance(6000) - 1 == pytest.approx(-0.05, abs=0.01)


@pytest.mark.slow
def test_planted_turbulence_comes_back(grid):
    """B2 and b of 60 observations of 18 scans without noise: medians within three of their own errors."""
    bins, table = grid
    layer = screen(11 / 3, 1000.0)
    zenith, track = np.full(18, math.pi / 2), np.full(18, TRACK)
    found = []
    for observation in range(60):
        data, bounds = realizations(layer, 18, 50 + 2 * observation, math.sqrt(280))
        profile = correlation_profile(scan_covariances(data, bounds), bins)
        fit = fit_turbulence(profile, bins, table, track_rad=track, elevation_rad=zenith, overlap=None)
        found.append((math.log(fit.b2[KOLMOGOROV, 3] / 280), INDEX_GRID[fit.chi2[:, 3].argmin()]))
    (level, index), (spread, scatter) = np.mean(found, axis=0), np.std(found, axis=0, ddof=1)
    # The mean of the logarithm lies below that of B2 by half its variance.
    assert level + spread**2 / 2 == pytest.approx(0, abs=3 * spread / math.sqrt(60))
    assert index == pytest.approx(11 / 3, abs=3 * scatter / math.sqrt(60) + 0.05)
