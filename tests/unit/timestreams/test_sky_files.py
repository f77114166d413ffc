"""Maps, catalogues and clusters on the grid of the sky, against closed forms."""

import math

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS

from mapmaker.geometry import MapGeometry, pixel_centres, plane_directions, plane_offsets
from surveysim.runtime.errors import InputError
from surveysim.scene.map_units import UNITS, contradicts, rj_mk_per_unit, unit_of_header
from surveysim.scene.passband import top_hat
from surveysim.scene.sky import SkyCatalogue, SkyCluster, SkyMap
from surveysim.timestreams.map_projection import map_on_grid, missing_cells
from surveysim.timestreams.sky_images import SkyImage, read_sky_image
from surveysim.timestreams.sky_sources import catalogue_mk, profile_in_beam

ARCSEC = math.radians(1 / 3600)
DEGREE = math.radians(1.0)
FWHM = 60 * ARCSEC
ACROSS_ZERO = MapGeometry(math.radians(0.05), math.radians(-20), 10 * ARCSEC, 120, 108)


def image_wcs(pixel_arcsec, n, *, frame="equatorial", projection="SIN", ra=359.99, dec=-20.01):
    found = WCS(naxis=2)
    names = ("RA--", "DEC-") if frame == "equatorial" else ("GLON", "GLAT")
    found.wcs.ctype = [f"{name}-{projection}" for name in names]
    found.wcs.crval, found.wcs.crpix = [ra, dec], [n / 2 + 0.3, n / 2 + 0.7]
    found.wcs.cdelt = [-pixel_arcsec / 3600, pixel_arcsec / 3600]
    return found


def gaussian(geometry, ra_deg, dec_deg, fwhm_rad):
    """Gaussian of integral 1 on the plane of a grid."""
    x, y = plane_offsets(geometry, math.radians(ra_deg), math.radians(dec_deg))
    xi, eta = pixel_centres(geometry)
    variance = fwhm_rad**2 / (8 * math.log(2))
    return np.exp(-((xi - x) ** 2 + (eta - y) ** 2) / (2 * variance)) / (2 * np.pi * variance)


# ---------------------------------------------------------------- images


@pytest.mark.parametrize("pixel", [7.0, 10.0, 15.0, 20.0])
@pytest.mark.parametrize("frame", ["equatorial", "galactic"])
def test_a_pixel_becomes_a_beam(pixel, frame):
    """One pixel of a map across RA 0, finer and coarser than the grid: the Gaussian beam of the same flux.

    An image that is a third of a beam wide is interpolated within 0.2 % of the peak, its flux kept within 1e-4. The
    plane of the grid differs from the sky by the square of 0.25 deg, 2e-5.
    """
    n = int(4000 / pixel)
    where = SkyCoord(0.08, -19.97, unit="deg")
    centre = SkyCoord(359.99, -20.01, unit="deg").galactic
    wcs = (
        image_wcs(pixel, n)
        if frame == "equatorial"
        else image_wcs(pixel, n, frame=frame, projection="TAN", ra=centre.l.deg, dec=centre.b.deg)
    )
    column, row = wcs.world_to_pixel(where)
    values = np.zeros((n, n))
    column, row = round(float(column)), round(float(row))
    values[row, column] = 1 / (pixel * ARCSEC) ** 2
    there = wcs.pixel_to_world(column, row).icrs
    found = map_on_grid(SkyImage(values, wcs, frame, "K_RJ", 0.0, ()), ACROSS_ZERO, (FWHM, 1.5 * FWHM))
    for sky, width in zip(found, (FWHM, 1.5 * FWHM), strict=True):
        expected = gaussian(ACROSS_ZERO, there.ra.deg, there.dec.deg, width)
        np.testing.assert_allclose(sky, expected, atol=2e-3 * expected.max())
        assert sky.sum() == pytest.approx(expected.sum(), rel=2e-4)


@pytest.mark.parametrize("dec", [60, 80])
def test_a_pixel_of_a_cylinder_far_from_its_equator(dec):
    """Columns of a plate carree are narrower by cos(dec): one pixel still is a beam of its flux."""
    wcs = image_wcs(20.0, 80, projection="CAR", ra=30.0, dec=0.0)
    wcs.wcs.crpix = [300.3, 40.2 - dec * 180]
    values = np.zeros((80, 600))
    column, row = 295, 44
    values[row, column] = 1 / (math.cos(math.radians(wcs.pixel_to_world(column, row).dec.deg)) * (20 * ARCSEC) ** 2)
    there, grid = wcs.pixel_to_world(column, row).icrs, MapGeometry(DEGREE * 30, DEGREE * dec, 10 * ARCSEC, 60, 60)
    sky = map_on_grid(SkyImage(values, wcs, "equatorial", "K_RJ", 0.0, ()), grid, (FWHM,))[0]
    expected = gaussian(grid, there.ra.deg, there.dec.deg, FWHM)
    np.testing.assert_allclose(sky, expected, atol=2e-3 * expected.max())
    assert sky.sum() == pytest.approx(expected.sum(), rel=2e-4)


@pytest.mark.parametrize("column", [0, 1, 359])
def test_sides_of_a_cylinder_around_the_sky_meet(column):
    """A pixel at the seam is the same as in the middle of the map that begins elsewhere."""
    grid, found = MapGeometry(math.pi, 0.0, DEGREE / 2, 24, 24), []
    for turn in (0, 90):
        wcs = image_wcs(3600.0, 360, projection="CAR", ra=float(turn), dec=0.0)
        wcs.wcs.crpix = [180.5, 20.5]
        values = np.zeros((40, 360))
        values[18, (column + turn) % 360] = 1.0
        image = SkyImage(values, wcs, "equatorial", "K_RJ", 0.0, ())
        found.append(map_on_grid(image, grid, (2.5 * DEGREE,))[0])
    assert found[1].max() > 0.1
    np.testing.assert_allclose(found[0], found[1], atol=1e-6)


def test_ecliptic_images_are_refused(tmp_path):
    """Astropy takes ecliptic axes for right ascension and declination."""
    wcs = image_wcs(20.0, 60)
    wcs.wcs.ctype = ["ELON-TAN", "ELAT-TAN"]
    header = wcs.to_header()
    header["BUNIT"] = "K_RJ"
    fits.writeto(tmp_path / "map.fits", np.ones((60, 60)), header)
    with pytest.raises(InputError, match="found coordinates ELON and ELAT; ICRS"):
        read_sky_image(SkyMap(map_file=tmp_path / "map.fits"))


def test_values_of_images(tmp_path):
    """Infinity and blanks are no values; a cut file and a plane of Stokes Q are refused."""
    header = image_wcs(20.0, 60).to_header()
    header["BUNIT"] = "K_RJ"
    values, path = np.ones((60, 60)), tmp_path / "map.fits"
    values[3, 4:7] = np.inf, -1.6375e30, np.nan
    fits.writeto(path, values, header)
    found = read_sky_image(SkyMap(map_file=path))
    assert np.isnan(found.values[3, 4:7]).all() and np.nansum(found.values) == 3597
    (tmp_path / "cut.fits").write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(InputError, match=r"cut\.fits: values can't be read"):
        read_sky_image(SkyMap(map_file=tmp_path / "cut.fits"))
    header.update({"CTYPE3": "STOKES", "CRPIX3": 1, "CRVAL3": 2, "CDELT3": 1})
    fits.writeto(tmp_path / "q.fits", np.ones((2, 60, 60)), header)
    with pytest.raises(InputError, match="found Stokes parameter 2 in the first plane; 1"):
        read_sky_image(SkyMap(map_file=tmp_path / "q.fits"))


def test_own_beam_of_a_map_counts():
    """A source of 40 arcsec in a map, through a beam of 60 arcsec, is 60 arcsec wide."""
    wcs = image_wcs(12.0, 320)
    own = MapGeometry(math.radians(359.99), math.radians(-20.01), 12 * ARCSEC, 320, 320)
    row, column = np.indices((320, 320))
    ra, dec = wcs.pixel_to_world_values(column, row)
    x, y = plane_offsets(own, np.radians(ra), np.radians(dec))
    at = plane_offsets(own, math.radians(0.08), math.radians(-19.97))
    values = np.exp(-4 * math.log(2) * ((x - at[0]) ** 2 + (y - at[1]) ** 2) / (40 * ARCSEC) ** 2)
    sky = map_on_grid(SkyImage(values, wcs, "equatorial", "K_RJ", 40 * ARCSEC, ()), ACROSS_ZERO, (FWHM,))[0]
    peak = gaussian(ACROSS_ZERO, 0.08, -19.97, FWHM) * (np.pi * FWHM**2 / (4 * math.log(2)))
    np.testing.assert_allclose(sky, (40 / 60) ** 2 * peak, atol=5e-4)


def test_missing_pixels_are_found_and_are_zero():
    wcs, values = image_wcs(20.0, 60), np.ones((60, 60))
    image = SkyImage(values, wcs, "equatorial", "K_RJ", 0.0, ())
    off, empty, total = missing_cells(image, ACROSS_ZERO, FWHM)
    # The map is 20 arcmin wide, its centre 3.6 arcmin west of the grid's, which is 20 by 18 arcmin and 2 beams more.
    assert 0.1 < off / total < 0.4 and empty == 0
    values[30, 20:40] = np.nan
    assert missing_cells(image, ACROSS_ZERO, FWHM)[1] > 0
    assert np.isfinite(map_on_grid(image, ACROSS_ZERO, (FWHM,))).all()


# ---------------------------------------------------------------- HEALPix


@pytest.mark.parametrize("frame", ["equatorial", "galactic", "ecliptic"])
def test_a_harmonic_of_a_healpix_map(frame):
    """One real harmonic, in the frame of the map, times the beam; the grid is close to the pole of galactic maps."""
    import healpy

    nside, ell, order = 64, 60, 7
    lmax, fwhm = 100, 3 * DEGREE
    alm = np.zeros(healpy.Alm.getsize(lmax), complex)
    alm[healpy.Alm.getidx(lmax, ell, order)] = 1 + 2j
    values = healpy.alm2map(alm, nside, lmax)
    grid = MapGeometry(0.01, -0.4, DEGREE / 2, 30, 24)
    sky = map_on_grid(SkyImage(values, None, frame, "K_RJ", DEGREE, ()), grid, (fwhm,))[0]
    ra, dec = plane_directions(grid, *pixel_centres(grid))
    place = SkyCoord(ra, dec, unit="rad")
    name = {"equatorial": "icrs", "galactic": "galactic", "ecliptic": "barycentricmeanecliptic"}[frame]
    turned = place.transform_to(name).represent_as("unitspherical")
    from scipy.special import sph_harm_y

    wave = sph_harm_y(ell, order, np.pi / 2 - turned.lat.rad, turned.lon.rad)
    beam = math.exp(-ell * (ell + 1) * (fwhm**2 - DEGREE**2) / (16 * math.log(2)))
    expected = 2 * beam * ((1 + 2j) * wave).real
    accuracy = 1e-4 if frame == "galactic" else 2e-5
    np.testing.assert_allclose(sky, expected, atol=accuracy * np.abs(expected).max())


def healpix_file(path, values, *, nest=False, **cards):
    table = fits.BinTableHDU.from_columns(
        [fits.Column(name, "D", unit="K_CMB", array=item) for name, item in values.items()]
    )
    nside = math.isqrt(len(next(iter(values.values()))) // 12)
    table.header.update({"PIXTYPE": "HEALPIX", "NSIDE": nside, "ORDERING": "NESTED" if nest else "RING"} | cards)
    table.writeto(path)
    return path


def test_healpix_files(tmp_path):
    """Ring and nested order; polarization is told to be ignored; a file of some pixels has NaN elsewhere."""
    import healpy

    ring = np.arange(12.0 * 4**2)
    nest = healpy.reorder(ring, r2n=True)
    columns = {"TEMPERATURE": nest, "Q_POLARISATION": nest}
    path = healpix_file(tmp_path / "nest.fits", columns, nest=True, COORDSYS="G")
    found = read_sky_image(SkyMap.model_validate({"map_file": path}))
    np.testing.assert_array_equal(found.values, ring)
    assert (found.frame, found.unit) == ("galactic", "K_CMB")
    assert found.notes == ("polarization is ignored: the column 'TEMPERATURE' is taken of TEMPERATURE, Q_POLARISATION",)
    some = fits.BinTableHDU.from_columns(
        [fits.Column("PIXEL", "J", array=[3, 5]), fits.Column("T", "D", unit="uK_CMB", array=[1.0, 2.0])]
    )
    some.header.update({"PIXTYPE": "HEALPIX", "NSIDE": 4, "ORDERING": "RING", "INDXSCHM": "EXPLICIT"})
    some.writeto(tmp_path / "some.fits")
    part = read_sky_image(SkyMap.model_validate({"map_file": tmp_path / "some.fits", "frame": "equatorial"}))
    assert part.values[[3, 5]].tolist() == [1, 2] and np.isnan(part.values).sum() == 190


# ---------------------------------------------------------------- units


BAND = top_hat(150e9, 0.2)


def scale(unit, band=BAND, frequency_ghz=None, index=None, own=0.0):
    frequency = None if frequency_ghz is None else frequency_ghz * 1e9
    return rj_mk_per_unit(
        unit, band, frequency_hz=frequency, spectral_index=index, own_fwhm_rad=own, beam_fwhm_rad=FWHM, area_m2=50.0
    )


def test_units_of_temperature():
    """Against astropy's equivalencies at one frequency, and the averages of the band."""
    one = top_hat(150e9, 0.0)
    cmb = (1 * u.Jy / u.sr).to(u.K, u.thermodynamic_temperature(150 * u.GHz, 2.7255 * u.K))
    rj = (1 * u.Jy / u.sr).to(u.K, u.brightness_temperature(150 * u.GHz))
    assert scale("K_RJ") == 1e3 and scale("mK_RJ") == 1.0 and scale("uK_RJ") == pytest.approx(1e-3, rel=1e-14)
    assert scale("K_CMB", one) == pytest.approx(1e3 * float(rj / cmb), rel=1e-6)
    assert scale("uK_CMB") == pytest.approx(1e-3 / BAND.cmb_per_rj, rel=1e-12)
    # A power law from 100 GHz: CMB temperature there, and the brightness over the squared frequency.
    cmb_100 = (1 * u.Jy / u.sr).to(u.K, u.thermodynamic_temperature(100 * u.GHz, 2.7255 * u.K))
    rj_100 = (1 * u.Jy / u.sr).to(u.K, u.brightness_temperature(100 * u.GHz))
    assert scale("mK_CMB", one, 100, 3.5) == pytest.approx(float(rj_100 / cmb_100) * 1.5**1.5, rel=1e-6)
    assert scale("mK_RJ", one, 100, 3.5) == pytest.approx(1.5**1.5, rel=1e-12)
    nu = np.linspace(135e9, 165e9, 20001)
    expected = np.trapezoid((nu / 100e9) ** 1.5, nu) / 30e9
    assert scale("mK_RJ", BAND, 100, 3.5) == pytest.approx(expected, rel=1e-8)


def test_units_of_flux():
    """A source of 1 Jy in a map has the peak S A / 2 k in the beam, as a point source, whatever the unit."""
    nu = np.linspace(135e9, 165e9, 20001)
    mean = np.trapezoid((nu / 100e9) ** 3.5, nu) / 30e9
    peak = 1e3 * (1 * u.Jy * mean * 50 * u.m**2 / 2).to_value(u.J) / 1.380649e-23
    beam = np.pi * FWHM**2 / (4 * math.log(2))
    own = 20 * ARCSEC
    assert scale("Jy/sr", BAND, 100, 3.5) / beam == pytest.approx(peak, rel=1e-7)
    assert scale("MJy/sr", BAND, 100, 3.5) == pytest.approx(1e6 * scale("Jy/sr", BAND, 100, 3.5), rel=1e-12)
    in_own = np.pi * own**2 / (4 * math.log(2))
    assert scale("Jy/beam", BAND, 100, 3.5, own) * in_own / beam == pytest.approx(peak, rel=1e-7)
    assert scale("mJy/beam", BAND, 100, 3.5, own) == pytest.approx(1e-3 * scale("Jy/beam", BAND, 100, 3.5, own))


def test_compton_y():
    """-T_CMB (4 - x coth(x / 2)) of y, in Rayleigh-Jeans temperature, at one frequency: -1.71 K at 150 GHz."""
    x = 6.62607015e-34 * 150e9 / (1.380649e-23 * 2.7255)
    rj = x**2 * np.exp(x) / np.expm1(x) ** 2
    expected = 1e3 * 2.7255 * (x / np.tanh(x / 2) - 4) * rj
    assert scale("Compton y", top_hat(150e9, 0.0)) == pytest.approx(expected, rel=1e-12)
    assert expected == pytest.approx(-1495.5, abs=60)


def test_names_of_units_in_headers():
    named = {
        "K_CMB": "K_CMB", "uK_CMB": "uK_CMB", "muK_CMB": "uK_CMB", "Jy/beam": "Jy/beam", "JY/BEAM": "Jy/beam",
        "MJy/sr": "MJy/sr", "MJy sr-1": "MJy/sr", "mJy beam-1": "mJy/beam", "K_RJ": "K_RJ", "y": "Compton y",
    }  # fmt: skip
    assert {text: unit_of_header(text) for text in named} == named
    assert unit_of_header("K") is None and unit_of_header("erg") is None
    assert contradicts("K_CMB", "K_RJ") and contradicts("Jy/sr", "K") and contradicts("K_CMB", "Jy/beam")
    assert not contradicts("K_CMB", "K") and not contradicts("K_CMB", "") and not contradicts("K_CMB", "counts")
    assert all(unit_of_header(name) == name for name in UNITS)


# ---------------------------------------------------------------- sources and clusters


def test_sources_of_a_catalogue(tmp_path):
    """A point and an extended source across RA 0: Gaussians of the same flux, averaged over the band."""
    from astropy.table import QTable

    table = QTable({"ra": [0.08, 359.95] * u.deg, "dec": [-19.97, -20.02] * u.deg, "flux": [3.0, 8.0] * u.mJy})
    table["size"], table["spectral_index"], table["remark"] = [0, 80] * u.arcsec, [0.0, 3.5], ["a", "b"]
    table.write(tmp_path / "c.ecsv")
    table.write(tmp_path / "c.fits")
    mean = BAND.power_law(100e9, 3.5)
    for name in ("c.ecsv", "c.fits"):
        section = SkyCatalogue.model_validate({"catalogue_file": tmp_path / name, "flux_frequency": "100 GHz"})
        sky = catalogue_mk(section, ACROSS_ZERO, (FWHM,), BAND, flux_scale=2e3 * FWHM**2)[0]
        beam = np.pi * FWHM**2 / (4 * math.log(2))
        expected = 2e3 * beam * 3e-3 * gaussian(ACROSS_ZERO, 0.08, -19.97, FWHM)
        expected += 2e3 * beam * 8e-3 * mean * gaussian(ACROSS_ZERO, 359.95, -20.02, 100 * ARCSEC)
        np.testing.assert_allclose(sky, expected, atol=1e-6)


@pytest.mark.parametrize("beta", [0.5, 1.0])
def test_beta_cluster_in_a_beam(beta):
    """Against the convolution in real space, in polar coordinates about the point."""
    section = SkyCluster.model_validate(
        {"ra": "0 deg", "dec": "0 deg", "y0": 1e-4, "profile": "beta", "core_radius": "90 arcsec", "beta": beta}
    )
    sigma, core = FWHM / math.sqrt(8 * math.log(2)), 90 * ARCSEC
    node, weight = np.polynomial.legendre.leggauss(120)
    radius, azimuth = (1 + node) * 4 * sigma, np.linspace(0, 2 * np.pi, 64, endpoint=False)
    share = weight * 4 * sigma * radius * np.exp(-(radius**2) / (2 * sigma**2)) / sigma**2 / 64
    for distance in np.array([0.0, 30, 120, 900]) * ARCSEC:
        there = distance**2 + radius[:, None] ** 2 - 2 * distance * radius[:, None] * np.cos(azimuth)
        expected = float(np.sum(share[:, None] * (1 + there / core**2) ** ((1 - 3 * beta) / 2)))
        found = profile_in_beam(section, np.array([distance, 1200 * ARCSEC]), FWHM)[0]
        assert found == pytest.approx(expected, rel=2e-4)


def test_arnaud_cluster_has_its_integral():
    """The integral over the sky is the transform at l = 0, the value in the centre less than 1 through a beam."""
    from mapmaker.profiles import arnaud_profile

    section = SkyCluster.model_validate(
        {"ra": "0 deg", "dec": "0 deg", "y0": 1e-4, "profile": "arnaud", "theta_500": "3 arcmin"}
    )
    radius = np.linspace(0, 25 * 60, 4001) * ARCSEC
    profile = profile_in_beam(section, radius, FWHM)
    assert np.trapezoid(2 * np.pi * radius * profile, radius) == pytest.approx(
        arnaud_profile(np.array(0.0), 180 * ARCSEC), rel=1e-3
    )
    assert 0.5 < profile[0] < 1 and (np.diff(profile[:2000]) < 0).all()
    assert np.abs(profile[radius > 17 * 60 * ARCSEC]).max() < 1e-6
