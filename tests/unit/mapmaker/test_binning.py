"""Binning kernels against their twins; maps to FITS and HEALPix and back."""

import warnings

import numpy as np
import pytest

from mapmaker.binning import (
    BinnedMap,
    bin_map,
    coadd,
    half_difference,
    map_shape,
    read_fits,
    weighted_mean,
    write_fits,
    write_healpix,
)
from mapmaker.geometry import MapGeometry, check_nside, finest_nside, plane_directions, wcs
from mapmaker.kernels.pixels import add_skies, bin_samples, count_samples, plane_pixels
from surveysim.survey.kernels import add_signed
from tests import naive

N_DET, N_SAMP, N_X, N_Y = 4, 90, 9, 7
BOUNDS = np.array([[0, 20], [25, 50], [50, 62], [70, 90]])
KEPT = np.array([True, False, True, True])
KINDS = pytest.mark.parametrize("kind", [np.float32, np.float64])
GEOMETRY = MapGeometry(*np.radians([132.3, 44.84]), np.radians(20 / 3600), 24, 18)


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def tracks(rng):
    """Boresight and detectors of which a part lies off a map of N_Y x N_X pixels."""
    place = np.empty((8, N_SAMP))
    place[0], place[3] = rng.uniform(-2, N_X + 2, N_SAMP), rng.uniform(-2, N_Y + 2, N_SAMP)
    place[[1, 2, 4, 5]] = rng.uniform(-1e3, 1e3, (4, N_SAMP))
    place[6:] = rng.uniform(-300, 300, (2, N_SAMP))
    place[6:, :5] = 1e4  # some detectors are behind the plane
    x, y = rng.uniform(-1e-3, 1e-3, (2, N_DET))
    return place, x, y


def at_places(column, row):
    """Places of one detector at the boresight, in an array that is parallel to the map and has its pixels as a unit."""
    one, none = np.ones(len(column)), np.zeros(len(column))
    return np.stack([column, one, none, row, none, one, none, none])


def test_plane_pixels(rng):
    arguments = tracks(rng)
    index = plane_pixels(*arguments, N_X, N_Y)
    expected = naive.plane_pixels(*arguments, N_X, N_Y)
    assert index.dtype == np.int32 and (expected == -1).any() and (expected >= 0).sum() > 100
    np.testing.assert_array_equal(index, expected)


def test_edges_of_the_map_and_undefined_pointing():
    """A pixel holds its lower edges and not its upper ones; just below 0 is off, not in pixel 0."""
    column = np.array([0.0, N_X, N_X - 1e-9, -1e-9, np.nan, 3.0, 3.0, np.inf])
    row = np.array([0.0, 1.0, N_Y - 1e-9, 1.0, 1.0, -1e-9, N_Y, 1.0])
    index = plane_pixels(at_places(column, row), np.zeros(1), np.zeros(1), N_X, N_Y)
    np.testing.assert_array_equal(index[0], [0, -1, N_X * N_Y - 1, -1, -1, -1, -1, -1])


def binning(rng, kind):
    data = rng.standard_normal((N_DET, N_SAMP)).astype(kind)
    index = rng.integers(-1, N_X * N_Y, (N_DET, N_SAMP)).astype(np.int32)
    return data, index, *naive.bin_samples(data, index, BOUNDS, KEPT, N_X * N_Y)


@KINDS
def test_bin_samples(rng, kind):
    data, index, total, hits = binning(rng, kind)
    found, found_hits = np.ones(N_X * N_Y), np.full(N_X * N_Y, 2, np.int64)  # adds to what is there
    bin_samples(data, index, BOUNDS, KEPT, found, found_hits)
    np.testing.assert_array_equal(found_hits - 2, hits)
    # Both sum at double precision: rounding of a few numbers of order 1.
    np.testing.assert_allclose(found - 1, total, atol=1e-14)
    assert hits.sum() == (index[:, np.r_[0:20, 50:62, 70:90]] >= 0).sum()


def test_count_samples(rng):
    """It adds the hits of all samples to those that are there."""
    index, scan = binning(rng, np.float32)[1], np.array([[0, N_SAMP]])
    hits = np.full(N_X * N_Y, 2, np.int64)
    count_samples(index, hits)
    expected = naive.bin_samples(np.zeros(index.shape), index, scan, [True], N_X * N_Y)[1]
    np.testing.assert_array_equal(hits - 2, expected)
    assert (index == -1).any() and expected.sum() == (index >= 0).sum()


@KINDS
def test_bin_samples_in_runs_and_without_hits(rng, kind):
    """Neighbours in one pixel are added up first, within a scan."""
    data = rng.standard_normal((N_DET, N_SAMP)).astype(kind)
    index = np.repeat(rng.integers(-1, 3, (N_DET, N_SAMP // 5)), 5, axis=1).astype(np.int32)
    total, hits = naive.bin_samples(data, index, BOUNDS, KEPT, N_X * N_Y)
    found, again, found_hits = np.zeros(N_X * N_Y), np.zeros(N_X * N_Y), np.zeros(N_X * N_Y, np.int64)
    bin_samples(data, index, BOUNDS, KEPT, found, found_hits)
    bin_samples(data, index, BOUNDS, KEPT, again, None)
    np.testing.assert_array_equal(found_hits, hits)
    np.testing.assert_allclose(found, total, atol=1e-13)
    np.testing.assert_array_equal(again, found)


@KINDS
def test_sums_of_many_samples_keep_double_precision(kind):
    """A million equal samples in one pixel: a single-precision sum would stall at 16.8 million."""
    data = np.full((1, 1_000_000), 33.25, kind)
    total, hits = np.zeros(1), np.zeros(1, np.int64)
    index = np.zeros(data.shape, np.int32)
    bin_samples(data, index, np.array([[0, data.size]]), np.array([True]), total, hits)
    assert total[0] == 33.25e6 and hits[0] == data.size


@KINDS
def test_add_skies(rng, kind):
    arguments = tracks(rng)
    skies, gain = rng.standard_normal((2, N_Y, N_X)).astype(kind), rng.uniform(0.5, 2, N_DET).astype(kind)
    start = rng.standard_normal((2, N_DET, N_SAMP)).astype(kind)
    found, expected = start.copy(), start.astype(float)
    add_skies(found, skies, *arguments, gain)
    for data, sky in zip(expected, skies.astype(float), strict=True):
        naive.add_sky(data, sky, *arguments, gain.astype(float))
    assert (expected != start).sum() > 100 and (expected == start).any()
    # A few operations on numbers of order 1.
    np.testing.assert_allclose(found, expected, atol=20 * np.finfo(kind).eps)


def test_a_linear_sky_is_looked_up_exactly():
    row, column = np.indices((N_Y, N_X)).astype(float)
    c, r = np.array([0.0, 2.25, 7.9]), np.array([0.5, 5.75, 0.0])
    data, sky = np.zeros((1, 1, 3)), (2 * column - 3 * row)[None]
    add_skies(data, sky, at_places(c, r), np.array([0.05]), np.array([0.1]), np.array([1.5]))
    np.testing.assert_allclose(data[0, 0], 1.5 * (2 * (c + 0.05) - 3 * (r + 0.1)), atol=1e-13)


@KINDS
def test_add_signed(rng, kind):
    total, values = (rng.standard_normal((n, 1300)).astype(kind) for n in (6, 4))
    signs = rng.choice([-1.0, 1.0], (6, 4)).astype(kind)
    expected = total.copy()
    naive.add_signed(expected, values, signs)
    add_signed(total, values, signs)
    np.testing.assert_array_equal(total, expected)


def random_map(rng, geometry=GEOMETRY):
    """A map whose sums come of the weights and signal, part of it not observed."""
    hits = rng.integers(0, 5, map_shape(geometry))
    weight = hits * rng.uniform(0.1, 0.3)
    return BinnedMap(geometry, rng.standard_normal(hits.shape) * weight, weight, hits)


def test_bin_map(rng):
    data = rng.standard_normal((N_DET, N_SAMP)).astype(np.float32)
    index = rng.integers(-1, GEOMETRY.n_x * GEOMETRY.n_y, data.shape).astype(np.int32)
    found = bin_map(GEOMETRY, data, index, BOUNDS, kept=KEPT)
    total, hits = naive.bin_samples(data, index, BOUNDS, KEPT, GEOMETRY.n_x * GEOMETRY.n_y)
    assert found.geometry == GEOMETRY
    np.testing.assert_array_equal(found.hits, hits.reshape(1, GEOMETRY.n_y, GEOMETRY.n_x))
    np.testing.assert_array_equal(found.weight, found.hits)
    np.testing.assert_allclose(found.weighted_sum.ravel(), total, atol=1e-14)
    seen = hits > 0
    np.testing.assert_allclose(found.signal_mk.ravel()[seen], total[seen] / hits[seen], atol=1e-14)
    assert (found.signal_mk.ravel()[~seen] == 0).all()


def test_weighted_mean_of_several_maps(rng):
    total, weight = rng.standard_normal((3, 4, 5)), rng.integers(0, 3, (4, 5)).astype(float)
    found = weighted_mean(total, weight)
    for k, i, j in np.ndindex(total.shape):
        assert found[k, i, j] == (total[k, i, j] / weight[i, j] if weight[i, j] else 0)


def test_coadd_weights(rng):
    """The co-add's signal is the weighted mean of the maps; weights and hits add."""
    maps, weights = [random_map(rng) for _ in range(3)], [0.5, 2.0, 0.0]
    found = coadd(maps, weights)
    per_map = [w * item.weight for w, item in zip(weights, maps, strict=True)]
    np.testing.assert_allclose(found.weight, sum(per_map), rtol=1e-14)
    np.testing.assert_array_equal(found.hits, sum(item.hits for item in maps))
    mean = sum(w * item.signal_mk for w, item in zip(per_map, maps, strict=True))
    seen = found.weight > 0
    np.testing.assert_allclose(found.signal_mk[seen], (mean / np.where(seen, found.weight, 1))[seen], rtol=1e-12)
    assert found.geometry == GEOMETRY


def test_a_map_read_back_adds_to_the_one_that_was_written(rng, tmp_path):
    """Degrees in the file round the angles; the geometry is the same all the same."""
    item = random_map(rng, MapGeometry(2.3090706, 0.78260563, 9.69627e-05, 30, 24))
    write_fits(tmp_path / "map.fits", item, {})
    both = coadd([read_fits(tmp_path / "map.fits"), item], [1.0, 1.0])
    np.testing.assert_array_equal(both.hits, 2 * item.hits)


def test_coadd_refuses_other_geometries_and_nothing(rng):
    other = MapGeometry(
        GEOMETRY.ra0_rad + 1e-6, *[getattr(GEOMETRY, k) for k in ("dec0_rad", "pixel_rad", "n_x", "n_y")]
    )
    with pytest.raises(ValueError, match="found no map"):
        coadd([], [])
    with pytest.raises(ValueError, match="map 1 has another geometry than map 0"):
        coadd([random_map(rng), random_map(rng, other)], [1.0, 1.0])
    with pytest.raises(ValueError):
        coadd([random_map(rng)] * 2, [1.0])


@pytest.fixture
def written(tmp_path, rng):
    item = random_map(rng)
    path = tmp_path / "maps" / "actual.fits"
    write_fits(path, item, {"SCENE": "small", "SEED": 7})
    return path, item


def test_fits_round_trip(written):
    path, item = written
    again = read_fits(path)
    for name in ("ra0_rad", "dec0_rad", "pixel_rad", "n_x", "n_y"):
        assert getattr(again.geometry, name) == pytest.approx(getattr(item.geometry, name), rel=1e-12)
    np.testing.assert_array_equal(again.hits, item.hits)
    assert again.hits.dtype == np.int64
    single = np.finfo(np.float32).eps
    np.testing.assert_allclose(again.weight, item.weight, rtol=single)
    np.testing.assert_allclose(again.signal_mk, item.signal_mk, rtol=2 * single)
    np.testing.assert_allclose(again.weighted_sum, item.weighted_sum, rtol=3 * single)
    assert [other.name for other in path.parent.iterdir()] == ["actual.fits"]


def test_fits_as_astropy_sees_it(written):
    """Three image extensions of one WCS, whose pixels lie where the geometry says."""
    from astropy.io import fits
    from astropy.wcs import WCS

    path, item = written
    with fits.open(path) as file:
        file.verify("exception")
        assert [hdu.name for hdu in file] == ["PRIMARY", "SIGNAL", "WEIGHT", "HITS"]
        assert (file[0].header["SCENE"], file[0].header["SEED"]) == ("small", 7)
        assert [hdu.header.get("BUNIT") for hdu in file[1:3]] == ["mK", "mK-2"]
        for hdu in file[1:]:
            seen = WCS(hdu.header)
            assert hdu.data.shape == (item.geometry.n_y, item.geometry.n_x)
            np.testing.assert_allclose(
                seen.wcs_pix2world(3, 11, 0), wcs(item.geometry).wcs_pix2world(3, 11, 0), rtol=1e-12
            )
        sky = WCS(file["SIGNAL"].header).pixel_to_world(3, 11)
        value = file["SIGNAL"].data[11, 3]
    g = item.geometry
    xi, eta = (g.n_x / 2 - 3.5) * g.pixel_rad, (11.5 - g.n_y / 2) * g.pixel_rad
    ra, dec = plane_directions(g, xi, eta)
    assert sky.frame.name == "icrs"
    assert [sky.ra.rad, sky.dec.rad] == pytest.approx([ra, dec], rel=1e-12)
    assert value == pytest.approx(item.signal_mk[0, 11, 3], rel=1e-6)


@pytest.mark.parametrize("centre", [(132.3, 44.84), (0.0, -68.75), (359.99, 0.0), (70.0, 89.5)])
def test_coordinates_of_the_header_are_as_astropy_writes_them(tmp_path, rng, centre):
    """The same cards, to the 14 digits that astropy's have; ours keep all."""
    from astropy.io import fits
    from astropy.wcs import WCS

    g = MapGeometry(*np.radians(centre), 9.69627e-05, 30, 24)
    expected = WCS(naxis=2)
    expected.wcs.ctype, expected.wcs.cunit, expected.wcs.radesys = ["RA---TAN", "DEC--TAN"], ["deg", "deg"], "ICRS"
    expected.wcs.crval, expected.wcs.crpix = np.degrees([g.ra0_rad, g.dec0_rad]), [15.5, 12.5]
    expected.wcs.cdelt = np.degrees([-g.pixel_rad, g.pixel_rad])
    write_fits(tmp_path / "map.fits", random_map(rng, g), {})
    header = fits.getheader(tmp_path / "map.fits", "SIGNAL")
    for card in expected.to_header().cards:
        value = pytest.approx(card.value, rel=1e-12, abs=1e-15) if isinstance(card.value, float) else card.value
        assert (header[card.keyword], header.comments[card.keyword]) == (value, card.comment)
    again = WCS(header)
    assert again.wcs.compare(expected.wcs, tolerance=1e-12) and wcs(g).wcs.compare(expected.wcs, tolerance=1e-12)


@pytest.mark.parametrize("share", [0.0, 0.05, 0.3, 0.5, 0.7, 0.8, 0.9])
def test_truncated_fits_is_refused(written, share):
    path, _ = written
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # astropy warns of what is refused here
        with pytest.raises(ValueError, match="not a whole map file") as caught:
            read_fits(path)
    assert str(path) in str(caught.value)


def test_other_files_are_refused(tmp_path):
    from astropy.io import fits

    (tmp_path / "text.fits").write_text("SIGNAL\n" * 1000)
    fits.PrimaryHDU(np.zeros((3, 3))).writeto(tmp_path / "plain.fits")
    with pytest.raises(ValueError, match="nowhere.fits: no such file; a map file is expected"):
        read_fits(tmp_path / "nowhere.fits")
    for name in ("text.fits", "plain.fits"):
        with pytest.raises(ValueError, match=f"{name}: not a whole map file"):
            read_fits(tmp_path / name)


@pytest.mark.parametrize("nside", [512, 4096])
def test_healpix_map_as_healpy_sees_it(tmp_path, rng, nside):
    import healpy

    item = random_map(rng)
    path = tmp_path / "maps" / "healpix.fits"
    write_healpix(path, item, nside)
    assert [other.name for other in path.parent.iterdir()] == ["healpix.fits"]
    g = item.geometry
    total, weight, hits = {}, {}, {}
    for row, column in np.ndindex(g.n_y, g.n_x):
        lon, lat = wcs(g).wcs_pix2world(column, row, 0)
        pixel = int(healpy.ang2pix(nside, lon, lat, nest=True, lonlat=True))
        for sums, plane in ((total, item.weighted_sum), (weight, item.weight), (hits, item.hits)):
            sums[pixel] = sums.get(pixel, 0) + plane[0, row, column]
    seen = sorted(pixel for pixel in hits if hits[pixel])
    assert 1 < len(seen) < (item.hits > 0).sum()
    check_table(
        path,
        nside,
        seen,
        [[total[p] / weight[p] for p in seen], [weight[p] for p in seen], [hits[p] for p in seen]],
    )
    if nside == 512:  # a whole sphere of 4096 takes 2 GB
        signal = healpy.read_map(path, field=0, nest=True)
        np.testing.assert_array_equal(np.flatnonzero(signal != healpy.UNSEEN), seen)
        np.testing.assert_allclose(signal[seen], [total[p] / weight[p] for p in seen], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("centre", [(0, 0), (45, 44.84), (20, 60), (45, 80), (359.99, -20), (10, 89.9)])
def test_the_finest_healpix_map_has_no_holes(tmp_path, centre):
    """Pixels as large as just allowed; a finer map loses pixels, which is why it is refused."""
    import healpy
    from astropy.io import fits

    nside = 512
    pixel_rad = np.sqrt(np.pi / 3) / (1.5 * nside) * (1 - 1e-9)
    assert finest_nside(pixel_rad) == nside
    ones = np.ones((1, 60, 60))
    item = BinnedMap(MapGeometry(*np.radians(centre), pixel_rad, 60, 60), ones, ones, ones.astype(int))
    write_healpix(tmp_path / "map.fits", item, nside)
    ra, dec = np.radians(centre)
    inner = healpy.query_disc(nside, healpy.ang2vec(np.pi / 2 - dec, ra), 27 * pixel_rad, nest=True)
    assert len(inner) > 500 and not np.setdiff1d(inner, fits.getdata(tmp_path / "map.fits", 1)["PIXEL"]).size
    with pytest.raises(ValueError, match="nside: found 1024 for pixels of .* arcsec; 512 or less is expected, a finer"):
        write_healpix(tmp_path / "finer.fits", item, 2 * nside)
    assert [path.name for path in tmp_path.iterdir()] == ["map.fits"]


@pytest.mark.parametrize("nside", [0, -8, 3, 12, 2.0, 64.5, np.nan, "64", None, True, 2**13, 2**14, 2**30, 2**70])
def test_other_nsides_are_refused(tmp_path, rng, nside):
    geometry = MapGeometry(0.0, 0.5, np.radians(30 / 3600), 24, 18)
    with pytest.raises(ValueError, match="nside: found"):
        write_healpix(tmp_path / "map.fits", random_map(rng, geometry), nside)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arcsec, nside", [(20, 4096), (30, 4096), (60, 2048), (1e-6, 2**29), (3600 * 60, 0)])
def test_finest_nside(arcsec, nside):
    assert finest_nside(np.radians(arcsec / 3600)) == nside
    if not nside:
        with pytest.raises(ValueError, match="nside: found 1 for pixels of .*; no nside is wide enough"):
            check_nside("nside", 1, np.radians(arcsec / 3600))


def test_half_difference_is_the_noise_of_the_coadd(rng):
    """A sky that both maps see alike goes, at any weights; noise has the variance of the co-add."""
    sky, sums = 100 * rng.standard_normal((1, 18, 24)), []
    weights = [rng.uniform(0.5, 2, sky.shape), rng.uniform(5, 20, sky.shape)]
    weights[0][0, 3, 4] = 0
    for _ in range(300):
        one, other = (
            BinnedMap(GEOMETRY, w * sky + np.sqrt(w) * rng.standard_normal(sky.shape), w, np.ones(sky.shape, int))
            for w in weights
        )
        sums.append(half_difference(one, other))
    found = np.array([item.signal_mk for item in sums])
    weight = sums[0].weight
    assert weight[0, 3, 4] == 0 and (found[:, 0, 3, 4] == 0).all()
    seen = weight > 0
    np.testing.assert_array_equal(weight[seen], (weights[0] + weights[1])[seen])
    scaled = (found * np.sqrt(weight))[:, seen]
    # 129,000 deviates of variance 1 and none of the sky's 100 mK.
    assert scaled.std() == pytest.approx(1, abs=0.01) and np.abs(scaled.mean(axis=0)).max() < 5 / np.sqrt(300)


def check_table(path, nside, pixels, columns):
    from astropy.io import fits

    with fits.open(path) as file:
        file.verify("exception")
        header, table = file[1].header, file[1].data
    expected = {
        "PIXTYPE": "HEALPIX",
        "ORDERING": "NESTED",
        "NSIDE": nside,
        "INDXSCHM": "EXPLICIT",
        "COORDSYS": "C",
    }
    assert {key: header[key] for key in expected} == expected
    np.testing.assert_array_equal(table["PIXEL"], pixels)
    for name, values in zip(("SIGNAL", "WEIGHT", "HITS"), columns, strict=True):
        # Single precision; sums of both signs may cancel to some 1e-6 of their terms.
        np.testing.assert_allclose(table[name], values, rtol=1e-5, atol=1e-6)
