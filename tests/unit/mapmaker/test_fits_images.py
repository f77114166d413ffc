"""FITS files of images, compared byte for byte with those of astropy."""

import subprocess
import sys

import numpy as np
import pytest
from astropy.io import fits

from mapmaker.fits_images import write_images
from mapmaker.geometry import MapGeometry, wcs_cards

GEOMETRIES = (MapGeometry(2.3090706, 0.78260563, 9.69627e-05, 30, 24), MapGeometry(0.0, -1.2, 1e-9, 5, 200))
HEADERS = (
    {},
    {"SCENE": "lynx", "DATASET": "average+pca", "SEED": 2**63, "NOBS": 0, "SHA256": "a" * 64, "DONE": True},
    {"SCENE": "x" * 68},
    {"SCENE": "x" * 69},
    {"SCENE": "O'Neill"},
    {"SCENE": ""},
    {"SCENE": "ends with a space "},
    {"object": "lower case", "A_KEYWORD_OF_MANY_LETTERS": 1},
    {"SIGMA": 1.5e-300, "ANSWER": ("value", "and comment"), "COMMENT": "a comment"},
    {"EXTEND": False, "NONE": None, "HUGE": 10**25},
)


def by_astropy(path, header, images):
    hdus = [fits.PrimaryHDU()]
    for key, value in header.items():
        hdus[0].header[key] = value
    for name, data, cards, unit in images:
        base = fits.Header([(keyword, *card) for keyword, card in cards.items()])
        image = fits.ImageHDU(data, header=base, name=name)
        image.header["BUNIT"] = unit
        hdus.append(image)
    fits.HDUList(hdus).writeto(path)


def images_of(geometry):
    rng = np.random.default_rng(5)
    plane = rng.normal(size=(geometry.n_y, geometry.n_x))
    cards = wcs_cards(geometry)
    kinds = (("SIGNAL", np.float32, "mK"), ("HITS", np.int32, ""), ("COUNTS", np.int64, "count"))
    return [(name, (100 * plane).astype(kind), cards, unit) for name, kind, unit in kinds]


@pytest.mark.filterwarnings("ignore")  # of keywords that are no standard ones
@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("geometry", GEOMETRIES)
def test_files_are_those_of_astropy(tmp_path, geometry, header):
    images = images_of(geometry)
    write_images(tmp_path / "ours.fits", header, images)
    by_astropy(tmp_path / "theirs.fits", header, images)
    assert (tmp_path / "ours.fits").read_bytes() == (tmp_path / "theirs.fits").read_bytes()


def test_maps_are_written_without_astropy(tmp_path):
    lines = [
        "import sys, numpy as np",
        "from mapmaker.binning import BinnedMap, write_fits",
        "from mapmaker.geometry import MapGeometry",
        "item = BinnedMap(MapGeometry(2.3, 0.7, 1e-4, 6, 4), *np.ones((2, 1, 4, 6)), np.ones((1, 4, 6), int), 'mK-2')",
        f"write_fits({str(tmp_path / 'map.fits')!r}, item, {{'SCENE': 'lynx', 'SEED': 1}})",
        "assert 'astropy' not in sys.modules",
    ]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True)
    assert (tmp_path / "map.fits").stat().st_size % 2880 == 0
