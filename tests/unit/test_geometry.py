"""The tangent plane against astropy's WCS, and where detectors look."""

import numpy as np
import pytest

from mapmaker.geometry import (
    MapGeometry,
    boresight_pixels,
    covering_geometry,
    pixel_indices,
    plane_directions,
    plane_offsets,
    sky_offsets,
    wcs,
)
from mapmaker.timestreams import FocalPlane, Timestreams

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


def test_detectors_on_the_sky_against_spherical_offsets(rng):
    """Detectors some arcmin from a boresight off the map's centre.

    Offsets are added in the plane, whose north differs from the boresight's by xi tan(dec): 0.2 degrees at
    12 arcmin, 1.2 arcsec for a detector 5.6 arcmin away. The plane's stretch, (xi^2 + eta^2), is 0.01 arcsec.
    """
    from astropy import units as u
    from astropy.coordinates import SkyCoord

    g = geometry(LYNX, 2400, 2400, ARCSEC)
    plane = FocalPlane(*rng.uniform(-4, 4, (2, 20)) * 60 * ARCSEC, 1e-4)
    xi, eta = rng.uniform(-12, 12, (2, 30)) * 60 * ARCSEC
    angle = rng.uniform(0, 2 * np.pi, 30)
    ra, dec = plane_directions(g, xi, eta)
    index = pixel_indices(g, streams_at(ra, dec, angle, plane))
    boresight = SkyCoord(ra * u.rad, dec * u.rad)
    for d in range(20):
        # The x axis lies 90 degrees clockwise of the y axis on the sky, so at angle - 90 degrees.
        toward = angle - np.arctan2(plane.x_rad[d], plane.y_rad[d])
        distance = np.hypot(plane.x_rad[d], plane.y_rad[d])
        seen = boresight.directional_offset_by(toward * u.rad, distance * u.rad)
        column, row = wcs(g).wcs_world2pix(seen.ra.deg, seen.dec.deg, 0)
        found_row, found_column = np.divmod(index[d], g.n_x)
        allowed = 0.5 + 0.02 + 1.02 * distance / ARCSEC * np.abs(xi) * np.tan(LYNX[1])
        assert (index[d] >= 0).all()
        assert (np.abs(found_column - column) < allowed).all()
        assert (np.abs(found_row - row) < allowed).all()


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


def test_pixels_follow_the_offsets(rng):
    g = geometry(LYNX)
    plane = FocalPlane(*rng.uniform(-1e-3, 1e-3, (2, 7)), 1e-4)
    xi, eta = rng.uniform(-6e-3, 6e-3, (2, 40))
    angle = rng.uniform(0, 2 * np.pi, 40)
    east, north = sky_offsets(plane, angle)
    column = np.floor(g.n_x / 2 - (xi[:, None] + east) / g.pixel_rad).astype(int).T
    row = np.floor(g.n_y / 2 + (eta[:, None] + north) / g.pixel_rad).astype(int).T
    inside = (column >= 0) & (column < g.n_x) & (row >= 0) & (row < g.n_y)
    expected = np.where(inside, row * g.n_x + column, -1)
    assert inside.any() and not inside.all()
    np.testing.assert_array_equal(boresight_pixels(g, xi, eta, angle, plane), expected)


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
