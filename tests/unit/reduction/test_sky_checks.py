"""Errors and notes of a scene's sky: one line each, with key, file, found and allowed."""

import math

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS

from surveysim.reduction.design_warnings import design_warnings
from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import load_scene
from tests.scenes import SMALL_SCENE, write_scene

RA, DEC = 132.3, 44.84
CLUSTER = '\n[[sky.clusters]]\nra = "132.3 deg"\ndec = "44.84 deg"\ny0 = 1e-4\nprofile = "arnaud"\n'


def scene_with(folder, text):
    """The small scene with a sky of its own."""
    before, _, rest = SMALL_SCENE.partition("[sky]\n")
    return write_scene(folder, before + "[sky]\n" + text + rest[rest.index("[cleaning]") :])


def refusal(folder, text):
    """The error of a scene, without the path of its file and its folder."""
    with pytest.raises(SceneError) as error:
        prepare(load_scene(scene_with(folder, text)))
    return str(error.value).replace(f"{folder}/small.toml: ", "").replace(f"{folder}/", "")


def image_file(path, values, pixel_arcsec=30.0, *, ra=RA, dec=DEC, **cards):
    wcs = WCS(naxis=values.ndim)
    for name, value in zip(
        ("ctype", "crval", "cdelt", "crpix"),
        (
            ["RA---TAN", "DEC--TAN"],
            [ra, dec],
            [-pixel_arcsec / 3600, pixel_arcsec / 3600],
            [n / 2 + 0.5 for n in values.shape[:-3:-1]],
        ),
        strict=True,
    ):
        rest = {"ctype": "STOKES"}.get(name, 1)
        setattr(wcs.wcs, name, value + [rest] * (values.ndim - 2))
    header = wcs.to_header()
    header.update({"BUNIT": "K_CMB"} | cards)
    fits.PrimaryHDU(values, header).writeto(path, overwrite=True)


MAP = '[[sky.maps]]\nmap_file = "m.fits"\n'


def test_a_map_is_read_and_makes_the_sky(tmp_path):
    """A uniform map of 1 mK in CMB temperature, with polarization, that is larger than the field."""
    values = np.full((3, 120, 120), 1e-3)
    image_file(tmp_path / "m.fits", values)
    setup = prepare(load_scene(scene_with(tmp_path, MAP)))
    expected = 1 / setup.scene.instrument.cmb_per_rj
    np.testing.assert_allclose(setup.sky.map_mk, expected, rtol=1e-4)
    assert "sky.maps.0: m.fits: polarization is ignored: the first of 3 planes is taken." in design_warnings(setup)


@pytest.mark.parametrize(
    ("change", "key", "expected"),
    [
        ({"BUNIT": "K"}, "", "unit: m.fits: found BUNIT 'K' in the file; one of K_RJ, mK_RJ"),
        ({"BUNIT": "Jy/beam"}, 'unit = "K_CMB"', "unit: m.fits: found 'K_CMB' for a map whose BUNIT is 'Jy/beam'"),
        ({"BUNIT": "Jy/beam"}, "", "frequency: m.fits: missing; the unit 'Jy/beam' needs it, and 'spectral_index'"),
        ({}, 'beam_fwhm = "90 arcsec"', "beam_fwhm: m.fits: found 90 arcsec; the camera's 60 arcsec or less is"),
        ({"BMAJ": 0.02, "BMIN": 0.01}, "", "beam_fwhm: m.fits: found a beam of 0.02 by 0.01 deg in the file;"),
        ({"RADESYS": "FK4", "EQUINOX": 1950.0}, "", "map_file: m.fits: found coordinates in fk4; ICRS, FK5 of J2000"),
        ({}, "hdu = 4", "hdu: m.fits: found 4 in a file of 1; 0 or less is expected"),
        ({}, 'frame = "galactic"', "frame: m.fits: found 'galactic' for an image, which has its own; none is expected"),
    ],
)  # fmt: skip
def test_headers_that_are_refused(tmp_path, change, key, expected):
    image_file(tmp_path / "m.fits", np.ones((120, 120)), **change)
    assert refusal(tmp_path, MAP + key + "\n").startswith(f"sky.maps.0.{expected}")


def test_edges_and_missing_values(tmp_path):
    """A map smaller than the field of the scans, beside it, and with a hole; zero on request."""
    image_file(tmp_path / "m.fits", np.ones((20, 20)))
    line = refusal(tmp_path, MAP)
    # 10 of 34 arcmin along each side.
    assert line.startswith("sky.maps.0.map_file: m.fits: found a map that lacks 0.92 of the field of the scans and")
    assert line.endswith("deg wide; all of it is expected, or missing = 'zero'")
    image_file(tmp_path / "m.fits", np.ones((120, 120)), ra=RA + 180, dec=-DEC)
    assert "lacks 1 of the field" in refusal(tmp_path, MAP)
    values = np.ones((120, 120))
    values[58:62, 58:62] = math.nan
    image_file(tmp_path / "m.fits", values)
    assert "found pixels without a value (NaN) in 0.00" in refusal(tmp_path, MAP)
    setup = prepare(load_scene(scene_with(tmp_path, MAP + 'missing = "zero"\n')))
    assert np.isfinite(setup.sky.map_mk).all() and setup.sky.map_mk.min() < 0.5 * setup.sky.map_mk.max()
    image_file(tmp_path / "m.fits", np.full((120, 120), math.nan))
    assert refusal(tmp_path, MAP) == "sky.maps.0.map_file: m.fits: found no pixel with a value; a map is expected"


def test_files_that_are_no_maps(tmp_path):
    assert refusal(tmp_path, MAP) == "sky.maps.0.map_file: m.fits: no such file in the folder of the scene"
    (tmp_path / "m.fits").write_text("no map")
    assert refusal(tmp_path, MAP).startswith("sky.maps.0.map_file: m.fits: not a FITS file (")
    fits.PrimaryHDU(np.ones((9, 9))).writeto(tmp_path / "m.fits", overwrite=True)
    assert "coordinates" in refusal(tmp_path, MAP)
    image_file(tmp_path / "m.fits", np.ones((120, 120)), 0.3)
    assert "found pixels of 0.3 arcsec" in refusal(tmp_path, MAP)


def test_sections_that_are_refused(tmp_path):
    """Of clusters, catalogues and spectra, and a sky of nothing."""
    assert refusal(tmp_path, "").startswith("sky: found nothing; one or more of 'cmb_band_power', 'spectrum', 'maps'")
    assert refusal(tmp_path, "curved_lmax = 100\n" + CLUSTER + 'theta_500 = "2 arcmin"\n').startswith(
        "sky.curved_lmax: found 100 without 'cmb_band_power' or 'spectrum'"
    )
    assert refusal(tmp_path, CLUSTER) == "sky.clusters.0.theta_500: missing; it is expected with the profile 'arnaud'"
    far = CLUSTER.replace("132.3", "140") + 'theta_500 = "2 arcmin"\n'
    assert refusal(tmp_path, far).startswith("sky.clusters.0: found a cluster 5.4")
    catalogue = '[[sky.catalogues]]\ncatalogue_file = "c.ecsv"\nflux_frequency = "143 GHz"\n'
    assert refusal(tmp_path, catalogue).startswith(
        "sky.catalogues.0.catalogue_file: c.ecsv: no such file in the folder"
    )
    head = "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: ra, datatype: float64, unit: deg}\n"
    head += (
        "# - {name: dec, datatype: float64, unit: deg}\n# - {name: flux, datatype: float64, unit: UNIT}\nra dec flux\n"
    )
    (tmp_path / "c.ecsv").write_text(head.replace("UNIT", "mJy") + "132.3 44.84 5\n132.3 94 5\n")
    assert "row 2, column 'dec': found 94 deg, and -90 to 90 deg is allowed" in refusal(tmp_path, catalogue)
    (tmp_path / "c.ecsv").write_text(head.replace("UNIT", "K") + "132.3 44.84 5\n")
    assert "column 'flux': found the unit 'K'" in refusal(tmp_path, catalogue)
    (tmp_path / "c.ecsv").write_text(head.replace("UNIT", "mJy") + '132.3 44.84 ""\n')
    assert "row 1, column 'flux': found nan Jy" in refusal(tmp_path, catalogue)
    (tmp_path / "c.ecsv").write_text(head.replace("UNIT", "mJy") + "10 44.84 1\n")
    assert refusal(tmp_path, catalogue) == (
        "sky.catalogues.0.spectral_index: missing; either the key or a column is expected"
    )
    assert "found none of its 1 sources within" in refusal(tmp_path, catalogue + "spectral_index = 0\n")


def test_spectra_that_are_refused(tmp_path):
    spectrum, path = 'spectrum = "s.dat"\n', tmp_path / "s.dat"
    ends = "; a table of CAMB or CLASS, of two columns, or of ell and cl in ECSV, is expected"
    path.write_text("#    L    TT  EE  BB  TE\n2 1000 0 0 0\n3000 20 0 0 0\n")
    assert refusal(tmp_path, spectrum) == (
        "sky.spectrum: s.dat: found multipoles up to 3000; 12000 (score.ell_max) or more are expected"
    )
    for text, expected in (
        ("2 1000 0\n3 1000 0\n", "found 3 columns without a header of CAMB or CLASS, and no 'spectrum_kind'"),
        ("2 1000\n3\n", "row 2: found 1 columns, and 2 in the row before"),
        ("2 1000\n3 x\n", "row 2: found '3 x', and numbers are needed"),
        ("3 1000\n2 900\n", "row 2, column 'l': found 2, and 0 or more, and more than in the row before is allowed"),
        ("3 1000\n4 nan\n", "row 2, column 'TT': found nan, and 0 or more is allowed"),
        ("2 1e-10\n3 1e-10\n", "found at most 1e-10 uK2, which is the size of numbers without unit"),
    ):
        path.write_text(text)
        assert refusal(tmp_path, spectrum) == f"sky.spectrum: s.dat: {expected}{ends}"
