from dataclasses import replace

import numpy as np
import pytest

from surveysim.scene.scan_figures import LissajousFigure
from surveysim.telescope.patterns.raster import Raster, observation_raster, raster_extent, raster_path
from surveysim.telescope.scans import duration_s, samples_per_scan

ARCMIN = np.pi / 180 / 60
LYNX = Raster(
    speed_rad_s=4 * ARCMIN,
    fastest_rad_s=4 * ARCMIN,
    n_scans=18,
    scan_s=15.0,
    turnaround_s=10.0,
    step_rad=2 * ARCMIN,
    dither_rad=1 * ARCMIN,
    sample_rate_hz=10.0,
)
CENTRED = np.zeros(2)
DIRECTIONS = pytest.mark.parametrize("along, axis", [("ra", 0), ("dec", 1)])
ROUNDING = 1e-15  # of offsets below 0.03 rad, times a few operations


def by_scan(path, axis):
    """Offsets along and across the scans, (n_scan, n_samples)."""
    offset = (path.xi_rad, path.eta_rad)
    shape = (path.mid_time_s.size, -1)
    return offset[axis].reshape(shape), offset[1 - axis].reshape(shape)


def test_shapes_and_scan_numbers():
    path = raster_path(LYNX, "ra", CENTRED)
    assert samples_per_scan(LYNX) == 150
    for samples in (path.time_s, path.xi_rad, path.eta_rad, path.scan):
        assert samples.shape == (18 * 150,)
    assert path.scan.dtype == np.int64
    assert path.velocity_rad_s.shape == (18, 2)
    np.testing.assert_array_equal(path.scan, np.repeat(np.arange(18), 150))


@DIRECTIONS
def test_length_is_speed_times_time(along, axis):
    ahead, _ = by_scan(raster_path(LYNX, along, CENTRED), axis)
    # From the middle of the first sampling interval to that of the last, so one interval short of the scan.
    expected = LYNX.speed_rad_s * (LYNX.scan_s - 1 / LYNX.sample_rate_hz)
    np.testing.assert_allclose(np.ptp(ahead, axis=1), expected, rtol=1e-13)


@DIRECTIONS
def test_velocity_alternates_and_is_the_slope_of_the_positions(along, axis):
    path = raster_path(LYNX, along, np.array([0.3, -0.2]) * ARCMIN)
    np.testing.assert_array_equal(path.velocity_rad_s[:, axis], LYNX.speed_rad_s * (-1.0) ** np.arange(18))
    np.testing.assert_array_equal(path.velocity_rad_s[:, 1 - axis], 0.0)
    ahead, across = by_scan(path, axis)
    slope = np.diff(ahead, axis=1) * LYNX.sample_rate_hz
    np.testing.assert_allclose(slope, path.velocity_rad_s[:, axis, None] * np.ones(149), rtol=1e-10)
    assert (np.diff(across, axis=1) == 0).all()


@DIRECTIONS
def test_symmetric_about_the_centre(along, axis):
    ahead, across = by_scan(raster_path(LYNX, along, CENTRED), axis)
    np.testing.assert_allclose(ahead, -ahead[:, ::-1], atol=ROUNDING)
    np.testing.assert_allclose(across, -across[::-1], atol=ROUNDING)


@DIRECTIONS
def test_step_between_scans(along, axis):
    _, across = by_scan(raster_path(LYNX, along, CENTRED), axis)
    np.testing.assert_allclose(np.diff(across[:, 0]), LYNX.step_rad, rtol=1e-12)


@DIRECTIONS
def test_dither_moves_the_whole_pattern(along, axis):
    dither = np.array([0.7, -0.4]) * ARCMIN
    still, moved = raster_path(LYNX, along, CENTRED), raster_path(LYNX, along, dither)
    np.testing.assert_allclose(moved.xi_rad - still.xi_rad, dither[0], atol=ROUNDING)
    np.testing.assert_allclose(moved.eta_rad - still.eta_rad, dither[1], atol=ROUNDING)
    np.testing.assert_array_equal(moved.time_s, still.time_s)


def test_times_leave_the_turnarounds_out():
    path = raster_path(LYNX, "ra", CENTRED)
    time = path.time_s.reshape(18, 150)
    np.testing.assert_allclose(time[:, 0], 0.05 + 25.0 * np.arange(18), rtol=1e-13)
    np.testing.assert_allclose(np.diff(time, axis=1), 0.1, rtol=1e-10)
    np.testing.assert_allclose(time[1:, 0] - time[:-1, -1], 10.0 + 0.1, rtol=1e-10)
    np.testing.assert_allclose(path.mid_time_s, time.mean(axis=1), rtol=1e-13)
    assert duration_s(LYNX) == pytest.approx(18 * 15 + 17 * 10, rel=1e-15)
    assert time[-1, -1] == pytest.approx(duration_s(LYNX) - 0.05, rel=1e-13)


def test_scan_of_broken_intervals_stays_symmetric():
    path = raster_path(replace(LYNX, scan_s=1.05, n_scans=1), "ra", CENTRED)
    assert path.time_s.size == 10
    np.testing.assert_allclose(path.xi_rad, -path.xi_rad[::-1], atol=ROUNDING)
    assert path.time_s[0] == pytest.approx(0.075)


def test_rounding_loses_no_sample():
    assert samples_per_scan(replace(LYNX, scan_s=1.1, sample_rate_hz=30.0)) == 33
    assert samples_per_scan(replace(LYNX, scan_s=0.7, sample_rate_hz=90.0)) == 63  # 62.99999999999999


def test_too_few_samples_says_what_was_found():
    short = replace(LYNX, scan_s=0.7)
    with pytest.raises(ValueError, match=r"0\.7 s at 10 Hz has 7 samples; at least 8"):
        raster_path(short, "ra", CENTRED)
    assert samples_per_scan(replace(LYNX, scan_s=0.8)) == 8


def test_unknown_direction():
    with pytest.raises(ValueError, match="'azimuth'"):
        raster_path(LYNX, "azimuth", CENTRED)


def test_a_lissajous_figure_is_added_to_both_directions():
    """TolTEC's rastajous: to offsets, mean velocities and extent; the path is no longer straight."""
    keys = {"amplitude_x": "0.5 arcmin", "amplitude_y": "0.7 arcmin", "period_x": "3 s", "period_y": "4.1 s"}
    both = replace(LYNX, added=LissajousFigure.model_validate(keys))
    for number in (0, 1):
        plain, found = (observation_raster(item, number, CENTRED, None) for item in (LYNX, both))
        x = 0.5 * ARCMIN * np.sin(2 * np.pi * plain.time_s / 3)
        y = 0.7 * ARCMIN * np.sin(2 * np.pi * plain.time_s / 4.1)
        np.testing.assert_allclose(found.xi_rad, plain.xi_rad + x, rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(found.eta_rad, plain.eta_rad + y, rtol=0, atol=ROUNDING)
        end = np.array([np.sin(2 * np.pi * 15 / 3) * 0.5, np.sin(2 * np.pi * 15 / 4.1) * 0.7]) * ARCMIN
        np.testing.assert_allclose((found.velocity_rad_s - plain.velocity_rad_s)[0], end / 15, atol=ROUNDING)
        assert plain.straight and not found.straight
    assert raster_extent(both, 0.5) == pytest.approx(raster_extent(LYNX, 0.5) + 0.7 * ARCMIN)
