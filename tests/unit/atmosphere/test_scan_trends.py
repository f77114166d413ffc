"""ScanTrends that scans share: the loops against dense algebra, and strips that have the trends they are given."""

import math

import numpy as np
import pytest

from surveysim.atmosphere import trend_kernels as kernels
from surveysim.atmosphere.scan_trends import draw_trends, strip_points
from surveysim.atmosphere.screen_simulation import StripCache, draw_strips, strip_step
from surveysim.atmosphere.thin_screen import LAG_MAX, Screen, structure_function, structure_slope, structure_table
from tests import naive
from tests.deviates import deviates

ARCMIN = math.radians(1 / 60)
SCREENS = [Screen(11 / 3, 8e-3), Screen(2 / 3, 8e-3), Screen(20 / 3, 8e-3, 2.0)]
HALF_WIDTH = 4 * ARCMIN


def cache(screen=SCREENS[0], half_width=HALF_WIDTH):
    return StripCache(screen, half_width, strip_step(screen, 0.0), "linear", "float64")


def scans(strips, n_scan, seed=1, spread=200 * ARCMIN):
    """StripPoints of scans from anywhere in a square, in any direction, 30 to 90 arcmin long."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * math.pi, n_scan)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return strip_points(strips, rng.uniform(0, spread, (n_scan, 2)), direction, rng.uniform(30, 90, n_scan) * ARCMIN)


def dense(item):
    """Covariance (n_scan, n_scan, 4, 4) of all trends, weights times -D / 2 between all points."""
    apart = item.place_rad[:, None, :, None] - item.place_rad[None, :, None]
    field = -0.5 * structure_function(item.screen, np.hypot(*np.moveaxis(apart, -1, 0)))
    return np.einsum("ami,abij,bnj->abmn", item.weight, field, item.weight, optimize=True)


@pytest.mark.parametrize("screen", SCREENS)
def test_table_is_the_structure_function_and_goes_on_as_a_power(screen):
    table = structure_table(screen)
    beam = screen.beam_rad
    for lag in np.geomspace(2e-6, 9.9e3, 40) * beam:
        assert kernels.structure(lag**2, *table) == pytest.approx(float(structure_function(screen, lag)), rel=1e-6)
    assert kernels.structure(0.0, *table) == 0.0
    end = LAG_MAX * beam
    slope = float(structure_slope(screen, end * (1 - 1e-12))) * end / float(structure_function(screen, end))
    for factor in (1.0, 3.0, 100.0):
        expected = float(structure_function(screen, end)) * factor**slope
        assert kernels.structure((factor * end) ** 2, *table) == pytest.approx(expected, rel=1e-5)


def test_trends_are_what_they_are_called():
    """Of a field that is a polynomial each trend takes its own term: none is left of its mean."""
    item = scans(cache(), 1)
    end = item.used[0] - 4
    x, y = 2 * item.column[0] / end - 1, 2 * item.lane[0] / item.lane.max() - 1
    found = np.array([item.weight[0] @ field for field in (np.ones(15), x, y, x**2, x * y)])
    np.testing.assert_allclose(found[0], 0.0, atol=1e-15)
    # Points are rounded to the lattice, a hundredth of the length.
    np.testing.assert_allclose(found[1:] - np.diag(np.diag(found[1:])), 0.0, atol=0.02)
    assert (np.diag(found[1:]) > 0.05).all()


def test_draws_are_those_of_the_dense_covariance():
    item = scans(cache(), 3)
    normals = np.random.default_rng(2).standard_normal((3, 4))
    found = kernels.draw_trends(item.place_rad, item.weight, normals, 2, *structure_table(item.screen))
    np.testing.assert_allclose(found, naive.draw_trends(dense(item), normals, 2), rtol=1e-5, atol=1e-12)


def test_covariances_hold_within_a_group_and_to_the_one_before():
    """Six scans in groups of two. The draw is linear in the normals: their images give the covariance."""
    item = scans(cache(), 6)
    table, size = structure_table(item.screen), 24
    image = np.array(
        [kernels.draw_trends(item.place_rad, item.weight, one.reshape(6, 4), 2, *table).ravel() for one in np.eye(size)]
    )
    found = (image.T @ image).reshape(6, 4, 6, 4).transpose(0, 2, 1, 3)
    expected = dense(item)
    spread = np.sqrt(np.einsum("aamm->am", expected))
    scale = spread[:, None, :, None] * spread[None, :, None, :]
    for a in range(6):
        for b in range(6):
            if abs(a // 2 - b // 2) <= 1:
                np.testing.assert_allclose((found - expected)[a, b] / scale[a, b], 0.0, atol=1e-5)
    assert np.abs((found - expected) / scale).max() > 1e-3


def test_scans_over_the_same_air_have_the_same_trends():
    strips = cache()
    corner, direction = np.zeros((12, 2)), np.tile([1.0, 0.0], (12, 1))
    item = strip_points(strips, corner, direction, np.full(12, 60 * ARCMIN))
    value = draw_trends(item, deviates(3)).value
    assert np.isfinite(value).all() and (np.abs(value[0]) > 0).all()
    assert (np.ptp(value, axis=0) < 1e-3 * np.abs(value[0])).all()


@pytest.mark.parametrize("screen", SCREENS)
@pytest.mark.parametrize("half_width", [0.0, HALF_WIDTH, 15 * ARCMIN])
def test_a_strip_has_the_trends_that_it_is_given(screen, half_width):
    """The change is cubic between the nodes of a grid: rms of 40 draws, in standard deviations of the trends.

    Detectors on one line do not see what varies across it.
    """
    strips = cache(screen, half_width)
    item = scans(strips, 2)
    spread = np.sqrt([np.diag(dense(item.scans(scan, scan + 1))[0, 0]) for scan in range(2)])
    error = np.empty((40, *spread.shape))
    for draw, row in enumerate(error):
        trends = draw_trends(item, deviates(2 * draw))
        for scan in range(2):
            strip = draw_strips(strips.strip_for(90 * ARCMIN), deviates(2 * draw + 1), [scan * 10**6])
            trends.impose([scan], strip)
            strip = strip[0]
            row[scan] = item.weight[scan] @ strip[item.lane[scan], item.column[scan]] - trends.value[scan]
    seen = slice(None) if half_width > 0 else slice(0, 4, 2)
    rms = np.sqrt(np.mean((error / spread) ** 2, axis=0))
    assert (rms[:, seen] <= (0.01 if screen.index > 3 else 0.1)).all()


@pytest.mark.parametrize("screen", SCREENS)
def test_a_strip_changes_by_kriging(screen):
    """K C^-1 (t - w T) at every point of the lattice, to 1e-3 of its range."""
    strips = cache(screen)
    item = scans(strips, 1)
    trends = draw_trends(item, deviates(6))
    before = draw_strips(strips.strip_for(90 * ARCMIN), deviates(7), [0])[0]
    after = before.copy()
    trends.impose([0], after[None])
    covariance, weight = dense(item)[0, 0], item.weight[0]
    lane, column = item.lane[0], item.column[0]
    solved = np.linalg.solve(covariance, trends.value[0] - weight @ before[lane, column])
    used = item.used[0] - 3
    rows, columns = np.mgrid[: len(before), :used]
    apart = np.hypot(columns[..., None] - column, rows[..., None] - lane) * item.step_rad
    expected = -0.5 * structure_function(screen, apart) @ (solved @ weight)
    found = (after - before)[:, :used]
    # But for a constant, of which contrasts know nothing.
    left = found - found.mean() - (expected - expected.mean())
    assert np.abs(left).max() < (1e-3 if screen.index > 3 else 1e-2) * np.ptp(expected)


def test_scans_without_length_or_width():
    """One detector at rest against the layer: all points are one, no trend is left, and nothing changes."""
    strips = cache(half_width=0.0)
    item = strip_points(strips, np.zeros((2, 2)), np.tile([1.0, 0.0], (2, 1)), np.zeros(2))
    trends = draw_trends(item, deviates(8))
    before = draw_strips(strips.strip_for(0.0), deviates(9), [0])[0]
    after = before.copy()
    trends.impose([1], after[None])
    assert np.isfinite(after).all() and np.isfinite(trends.value).all()


def test_a_strip_that_lacks_a_point_is_refused():
    strips = cache()
    trends = draw_trends(scans(strips, 1), deviates(4))
    strip = draw_strips(strips.strip_for(90 * ARCMIN), deviates(5), [0])[0]
    for short in (strip[:-1], strip[:, : trends.points.column.max()]):
        with pytest.raises(ValueError, match="found strips of .* or more are expected"):
            trends.impose([0], np.ascontiguousarray(short)[None])
