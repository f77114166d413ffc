"""The tangent plane against astropy's WCS, and where detectors look."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.fft import next_fast_len

from mapmaker.detector_places import array_homography
from mapmaker.geometry import (
    MapGeometry,
    boresight_pixels,
    covering_geometry,
    fast_length,
    mean_direction,
    north_angle,
    pixel_indices,
    plane_directions,
    plane_offsets,
    same_geometry,
    sky_offsets,
    wcs,
)
from mapmaker.timestreams import FocalPlane, Timestreams
from tests import naive

ARCSEC = np.pi / 180 / 3600
LYNX = np.radians([132.3, 44.84])
CENTRES = [LYNX, np.radians([359.99, -30.0]), np.radians([0.005, 0.0]), np.radians([70.0, 89.5])]
ON_SKY = pytest.mark.parametrize("centre", CENTRES, ids=lambda c: f"{np.degrees(c)}")


def geometry(centre, n_x=90, n_y=64, pixel_rad=30 * ARCSEC):
    return MapGeometry(*centre, pixel_rad, n_x, n_y)


def plane_points(g, rng, n=200):
    """Points (xi, eta) [rad] on and a little beyond the map, with their positions in pixels from 0."""
    column, row = rng.uniform(-5, g.n_x + 5, n), rng.uniform(-5, g.n_y + 5, n)
    return (g.n_x / 2 - 0.5 - column) * g.pixel_rad, (row - g.n_y / 2 + 0.5) * g.pixel_rad, column, row


@ON_SKY
def test_gnomonic_against_astropy(centre, rng):
    """astropy works in degrees with its own formulae: 1e-9 pixels leaves room for rounding at RA 360."""
    g = geometry(centre)
    xi, eta, column, row = plane_points(g, rng)
    ra, dec = plane_directions(g, xi, eta)
    expected_ra, expected_dec = np.radians(wcs(g).wcs_pix2world(column, row, 0))
    assert (ra >= 0).all() and (ra < 2 * np.pi).all()
    difference = np.mod(ra - expected_ra + np.pi, 2 * np.pi) - np.pi
    np.testing.assert_allclose(difference * np.cos(dec), 0, atol=1e-12)
    np.testing.assert_allclose(dec, expected_dec, atol=1e-12)
    back_column, back_row = wcs(g).wcs_world2pix(np.degrees(ra), np.degrees(dec), 0)
    found_xi, found_eta = plane_offsets(g, ra, dec)
    np.testing.assert_allclose(g.n_x / 2 - 0.5 - found_xi / g.pixel_rad, back_column, atol=1e-9)
    np.testing.assert_allclose(g.n_y / 2 - 0.5 + found_eta / g.pixel_rad, back_row, atol=1e-9)


@ON_SKY
def test_there_and_back(centre, rng):
    g = geometry(centre)
    xi, eta, _, _ = plane_points(g, rng)
    again = plane_offsets(g, *plane_directions(g, xi, eta))
    # Rounding of angles of order 1 rad.
    np.testing.assert_allclose(again, [xi, eta], atol=2e-15)


def test_east_and_north():
    g = geometry(LYNX)
    ra, dec = LYNX
    xi, eta = plane_offsets(g, np.array([ra + 1e-4, ra]), np.array([dec, dec + 1e-4]))
    assert xi == pytest.approx([1e-4 * np.cos(dec), 0], rel=1e-6, abs=1e-15)
    assert eta[1] == pytest.approx(1e-4, rel=1e-6)
    # East has the higher right ascension and the lower column; north the higher row.
    column, row = wcs(g).wcs_world2pix(np.degrees([ra + 1e-4, ra]), np.degrees([dec, dec + 1e-4]), 0)
    assert column[0] < g.n_x / 2 - 0.5 < g.n_x and row[1] > g.n_y / 2 - 0.5


def streams_at(ra, dec, angle=None, plane=None):
    n = len(ra)
    plane = plane or FocalPlane(np.zeros(1), np.zeros(1), 1e-4)
    angle = np.zeros(n) if angle is None else angle
    return Timestreams(np.zeros((len(plane.x_rad), n)), np.arange(n) / 10, ra, dec, angle, np.zeros(n, int), plane)


@ON_SKY
def test_every_pixel_centre_of_the_wcs_is_in_its_pixel(centre):
    g = geometry(centre)
    row, column = np.indices((g.n_y, g.n_x))
    ra, dec = np.radians(wcs(g).wcs_pix2world(column.ravel(), row.ravel(), 0))
    index = pixel_indices(g, streams_at(ra, dec))
    assert index.dtype == np.int32 and index.shape == (1, g.n_y * g.n_x)
    np.testing.assert_array_equal(index[0], np.arange(g.n_y * g.n_x))


@ON_SKY
def test_pixels_off_the_map_are_minus_one(centre):
    g = geometry(centre)
    column = np.array([-0.51, g.n_x - 0.49, 10, 10, -0.49, g.n_x - 0.51])
    row = np.array([10, 10, -0.51, g.n_y - 0.49, -0.49, g.n_y - 0.51])
    index = pixel_indices(g, streams_at(*np.radians(wcs(g).wcs_pix2world(column, row, 0))))
    np.testing.assert_array_equal(index[0], [-1, -1, -1, -1, 0, g.n_x * g.n_y - 1])


@pytest.mark.parametrize("dec_deg", [0, 45, -45, 85, 89])
def test_the_array_angle_is_the_position_angle_at_the_boresight(dec_deg, rng):
    """Detectors up to 4 arcmin from boresights 25 arcmin off the centre, within 0.041 arcsec of astropy's offsets.

    A pixel is known to 0.04 arcsec; offsets are tangents, longer than their angles by 1e-4 arcsec.
    """
    from astropy import units as u
    from astropy.coordinates import SkyCoord

    g = MapGeometry(*np.radians([359.99, dec_deg]), 0.08 * ARCSEC, 46_000, 46_000)
    plane = FocalPlane(*rng.uniform(-4, 4, (2, 20)) / np.sqrt(2) * 60 * ARCSEC, 1e-4)
    centre = SkyCoord(359.99 * u.deg, dec_deg * u.deg)
    boresight = centre.directional_offset_by(np.arange(30) * 12 * u.deg, 25 * u.arcmin)
    angle = rng.uniform(0, 2 * np.pi, 30)
    row, column = np.divmod(pixel_indices(g, streams_at(boresight.ra.rad, boresight.dec.rad, angle, plane)), g.n_x)
    assert (row >= 0).all()
    for d in range(20):
        # The x axis lies 90 degrees clockwise of the y axis on the sky, so at angle - 90 degrees.
        toward = angle - np.arctan2(plane.x_rad[d], plane.y_rad[d])
        seen = boresight.directional_offset_by(toward * u.rad, np.hypot(plane.x_rad[d], plane.y_rad[d]) * u.rad)
        xi, eta = plane_offsets(g, seen.ra.rad, seen.dec.rad)
        np.testing.assert_allclose((g.n_x / 2 - 0.5 - column[d]) * g.pixel_rad, xi, atol=0.041 * ARCSEC)
        np.testing.assert_allclose((row[d] - g.n_y / 2 + 0.5) * g.pixel_rad, eta, atol=0.041 * ARCSEC)


@ON_SKY
def test_north_angle_against_a_step_to_the_north(centre, rng):
    g = geometry(centre)
    xi, eta, _, _ = plane_points(g, rng)
    ra, dec = plane_directions(g, xi, eta)
    there = plane_offsets(g, ra, dec + 1e-6)
    # A step of 1e-6 is rounded to 1e-10 of itself and more: declinations near 1.57 have 2e-16 each.
    found = np.arctan2(there[0] - xi, there[1] - eta)
    np.testing.assert_allclose(np.mod(north_angle(g, xi, eta) - found + np.pi, 2 * np.pi), np.pi, atol=1e-8)


@ON_SKY
def test_behind_the_tangent_plane_is_nowhere(centre):
    """The antipode has the centre's gnomonic offsets, and must not be taken for it; nor is the horizon in the plane."""
    g = geometry(centre)
    ra, dec = centre
    behind = np.array([ra + np.pi, ra + np.pi, ra + np.pi / 2]), np.array([-dec, -dec + 1e-4, 0.0])
    assert np.isnan(plane_offsets(g, *behind)).all()
    np.testing.assert_array_equal(pixel_indices(g, streams_at(*behind)), -1)
    assert np.isfinite(plane_offsets(g, ra, dec - np.radians(89.9))).all()


@pytest.mark.parametrize("dec_deg", [-89.9, 0.0, 44.84, 89.9])
@pytest.mark.parametrize("ra_deg", [0.0, 0.05, 180.0, 359.95])
def test_mean_direction_is_the_centre_of_a_symmetric_pattern(ra_deg, dec_deg, rng):
    """Across RA 0 and around a pole; the mean of points opposite to each other is in the middle, to rounding."""
    g = MapGeometry(*np.radians([ra_deg, dec_deg]), 1e-4, 1, 1)
    xi, eta = rng.uniform(-0.01, 0.01, (2, 50))
    ra, dec = plane_directions(g, np.append(xi, -xi), np.append(eta, -eta))
    found = mean_direction(ra, dec)
    assert 0 <= found[0] < 2 * np.pi
    np.testing.assert_allclose(plane_offsets(g, *found), 0, atol=1e-15)


@pytest.mark.parametrize("ra, dec", [([], []), ([0.0, np.pi], [0.0, 0.0]), ([np.nan, 1.0], [0.0, 0.0])])
def test_no_mean_direction(ra, dec):
    with pytest.raises(ValueError, match="mean vector|ra_rad: found nan"):
        mean_direction(np.array(ra), np.array(dec))


def test_numbers_of_a_large_map(rng):
    """The last pixels of the largest map have the right numbers; those of a larger one would wrap."""
    g = MapGeometry(*LYNX, ARCSEC / 100, 46_340, 46_340)
    column, row = np.array([0, 46_339, 46_339, 5]), np.array([0, 46_339, 0, 46_338])
    xi, eta = (g.n_x / 2 - 0.5 - column) * g.pixel_rad, (row + 0.5 - g.n_y / 2) * g.pixel_rad
    index = boresight_pixels(g, xi, eta, np.zeros(4), plane=FocalPlane(np.zeros(1), np.zeros(1), 1e-4))
    np.testing.assert_array_equal(index[0], row * 46_340 + column)
    for n_x, n_y in ((50_000, 50_000), (2**16, 2**15), (0, 10), (10, -1)):
        with pytest.raises(ValueError, match=f"found a map of {n_x} x {n_y} pixels; 1 to 2147483647"):
            MapGeometry(*LYNX, ARCSEC, n_x, n_y)
    with pytest.raises(ValueError, match="pixels in all are expected"):
        covering_geometry(*LYNX, ARCSEC, 25_000 * ARCSEC)


def test_one_geometry_by_turns_of_right_ascension():
    g = geometry(LYNX)
    assert same_geometry(g, replace(g, ra0_rad=g.ra0_rad - 2 * np.pi))
    assert not same_geometry(g, replace(g, ra0_rad=g.ra0_rad + 1e-9))


@pytest.mark.parametrize(
    "angle_deg, x_axis, y_axis",
    [
        (0, (-1, 0), (0, 1)),  # y north; x, 90 degrees clockwise of it as seen on the sky, west
        (90, (0, 1), (1, 0)),  # y east, x north
        (180, (1, 0), (0, -1)),
        (45, (-np.sqrt(0.5), np.sqrt(0.5)), (np.sqrt(0.5), np.sqrt(0.5))),
    ],
)
def test_axes_of_the_array_on_the_sky(angle_deg, x_axis, y_axis):
    plane = FocalPlane(np.array([1e-3, 0.0]), np.array([0.0, 2e-3]), 1e-4)
    xi, eta = sky_offsets(plane, np.radians([angle_deg]))
    assert xi.shape == eta.shape == (1, 2)
    np.testing.assert_allclose([xi[0, 0], eta[0, 0]], np.multiply(x_axis, 1e-3), atol=1e-18)
    np.testing.assert_allclose([xi[0, 1], eta[0, 1]], np.multiply(y_axis, 2e-3), atol=1e-18)


@pytest.mark.parametrize("dec0", [-1.5, 0.0, 0.78, np.pi / 2])
def test_detectors_are_at_their_lines_of_sight(dec0, rng):
    """An array of 2 degrees anywhere in a plane of 40 degrees, against vectors; the angle by a step is good to 1e-9."""
    xi, eta = rng.uniform(-0.36, 0.36, (2, 40))
    angle, (x, y) = rng.uniform(0, 2 * np.pi, 40), rng.uniform(-0.02, 0.02, (2, 40))
    h = array_homography(dec0, xi, eta, angle)
    depth = 1 + h[6] * x + h[7] * y
    found = (h[0] + h[1] * x + h[2] * y) / depth, (h[3] + h[4] * x + h[5] * y) / depth
    expected = [naive.line_of_sight(dec0, *of) for of in zip(xi, eta, angle, x, y, strict=True)]
    np.testing.assert_allclose(np.transpose(found), expected, rtol=0, atol=1e-9)


def test_at_the_pole_the_plane_angle_is_the_plane_s_own():
    h = array_homography(np.pi / 2, np.zeros(2), np.array([0.0, 1e-9]), np.full(2, 0.3))
    np.testing.assert_allclose(h[:, 0], h[:, 1], atol=2e-9)
    np.testing.assert_allclose(h[1:3, 0], [-np.cos(0.3), np.sin(0.3)], atol=1e-15)


def test_pixels_follow_the_offsets(rng):
    """Near the centre, where arrays are added in the plane but for 1e-6 of an offset: none of these is at an edge."""
    g = geometry(LYNX)
    plane = FocalPlane(*rng.uniform(-1e-3, 1e-3, (2, 7)), 1e-4)
    xi, eta = rng.uniform(-6e-4, 6e-4, (2, 40))
    angle = rng.uniform(0, 2 * np.pi, 40)
    east, north = sky_offsets(plane, angle)
    column = np.floor(g.n_x / 2 - (xi[:, None] + east) / g.pixel_rad).astype(int).T
    row = np.floor(g.n_y / 2 + (eta[:, None] + north) / g.pixel_rad).astype(int).T
    np.testing.assert_array_equal(boresight_pixels(g, xi, eta, angle, plane=plane), row * g.n_x + column)
    far = boresight_pixels(g, xi + 1.0, eta, angle, plane=plane)
    np.testing.assert_array_equal(far, -1)


@pytest.mark.parametrize("half_extent_px", [0.3, 1, 10.2, 21.5, 36, 60, 61.01, 500])
def test_covering_geometry(half_extent_px):
    pixel = 20 * ARCSEC
    g = covering_geometry(*LYNX, pixel, half_extent_px * pixel)
    assert (g.ra0_rad, g.dec0_rad, g.pixel_rad) == (*LYNX, pixel)
    assert g.n_x == g.n_y and g.n_x % 2 == 0
    assert g.n_x / 2 >= half_extent_px
    # Products of 2, 3 and 5 are nowhere more than a fourth apart; a margin of 4 pixels before that, 2 after.
    assert g.n_x <= 1.25 * (2 * half_extent_px + 4) + 2


@pytest.mark.parametrize("half_extent_px", range(1, 200, 7))
def test_covering_geometry_is_good_for_ffts(half_extent_px):
    n = covering_geometry(0.0, 0.0, 1e-4, (half_extent_px - 0.5) * 1e-4).n_x
    for factor in (2, 3, 5):
        while n % factor == 0:
            n //= factor
    assert n == 1


@pytest.fixture
def rng():
    return np.random.default_rng(20031028)


def test_fast_lengths_are_those_of_scipy():
    assert [fast_length(n) for n in range(1, 3000)] == [next_fast_len(n, real=True) for n in range(1, 3000)]
