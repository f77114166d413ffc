"""Reader and writer of maps: what files may hold, and what is refused by file and fault in one line."""

from dataclasses import replace

import numpy as np
import pytest
from astropy.io import fits

from mapmaker.binning import BinnedMap, bin_map, coadd, half_difference, read_fits, write_fits
from mapmaker.geometry import MapGeometry
from tests.refusals import refused

GEOMETRY = MapGeometry(*np.radians([0.0, -30.0]), np.radians(30 / 3600), 12, 9)
RNG = np.random.default_rng(6)


def a_map(unit="mK-2"):
    hits = RNG.integers(0, 5, (1, GEOMETRY.n_y, GEOMETRY.n_x))
    weight = hits * (1.0 if unit == "count" else 0.2)
    return BinnedMap(GEOMETRY, RNG.standard_normal(hits.shape) * weight, weight, hits, unit)


@pytest.fixture
def map_path(tmp_path):
    write_fits(tmp_path / "map.fits", a_map(), {})
    return tmp_path / "map.fits"


def change_map(path, change):
    with fits.open(path, memmap=False) as file:
        file = fits.HDUList([hdu.copy() for hdu in file])
    file = change(file) or file
    file.writeto(path, overwrite=True)


def set_data(name, of):
    def change(file):
        file[name].data = of(file[name].data)

    return change


def set_card(name, key, value):
    def change(file):
        file[name].header[key] = value

    return change


def edge(array, value):
    array = array.copy()
    array[2, 3] = value
    return array


def table_in_place(file):
    column = fits.Column("A", "E", array=np.zeros(3))
    file[1] = fits.BinTableHDU.from_columns([column], name="SIGNAL")


WRONG_MAPS = {
    "1-D": set_data("SIGNAL", lambda a: a[0]),
    "3-D": set_data("WEIGHT", lambda a: a[None].repeat(2, 0)),
    "no pixels": set_data("HITS", lambda a: None),
    "another shape": set_data("WEIGHT", lambda a: a[:-1]),
    "another width": set_data("HITS", lambda a: a[:, :-2]),
    "weight NaN": set_data("WEIGHT", lambda a: edge(a, np.nan)),
    "weight inf": set_data("WEIGHT", lambda a: edge(a, np.inf)),
    "weight negative": set_data("WEIGHT", lambda a: edge(a, -1)),
    "signal inf": set_data("SIGNAL", lambda a: edge(a, np.inf)),
    "hits negative": set_data("HITS", lambda a: edge(a, -3)),
    "hits halves": set_data("HITS", lambda a: edge(a.astype(float), 2.5)),
    "hits NaN": set_data("HITS", lambda a: edge(a.astype(float), np.nan)),
    "a table": table_in_place,
    "no weight": lambda file: fits.HDUList([file[0], file[1], file[3]]),
    "another centre": set_card("WEIGHT", "CRVAL1", 10.0),
    "another pixel": set_card("HITS", "CDELT2", 0.1),
    "oblong": set_card("SIGNAL", "CDELT1", -0.1),
    "mirrored": set_card("SIGNAL", "CDELT1", 30 / 3600),
    "off centre": set_card("SIGNAL", "CRPIX1", 1.0),
    "another projection": set_card("SIGNAL", "CTYPE1", "RA---SIN"),
    "galactic": set_card("SIGNAL", "CTYPE1", "GLON-TAN"),
    "turned": set_card("SIGNAL", "PC1_2", 0.5),
    "turned about the centre": set_card("WEIGHT", "LONPOLE", 90.0),
    "sheared": set_card("HITS", "CD2_1", 0.1),
    "distorted": set_card("SIGNAL", "PV2_1", 0.5),
    "in radians": set_card("SIGNAL", "CUNIT1", "rad"),
    "in arcmin": set_card("WEIGHT", "CUNIT2", "arcmin"),
    "of 1950": set_card("SIGNAL", "RADESYS", "FK4"),
    "of its date": set_card("HITS", "EQUINOX", 2026.9),
    "text": set_card("SIGNAL", "CRVAL1", "east"),
    "beyond the pole": set_card("SIGNAL", "CRVAL2", 91.0),
    "pixel of 0": set_card("SIGNAL", "CDELT2", 0.0),
    "uK": set_card("SIGNAL", "BUNIT", "uK"),
    "weights in Jy": set_card("WEIGHT", "BUNIT", "Jy-2"),
}


@pytest.mark.parametrize("kind", WRONG_MAPS)
def test_wrong_maps(map_path, kind):
    change_map(map_path, WRONG_MAPS[kind])
    refused(read_fits, map_path, "not a whole map file")


def same_map(one, other):
    for name in ("weighted_sum", "weight", "hits"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-6, atol=1e-9)
        assert getattr(one, name).dtype.isnative
    assert one.weight_unit == other.weight_unit


def compressed(file):
    images = [
        fits.CompImageHDU(h.data, h.header, name=h.name, compression_type="GZIP_2", quantize_level=0.0)
        for h in file[1:]
    ]
    return fits.HDUList([file[0], *images])


def nan_where_nothing_was_observed(file):
    file["SIGNAL"].data = np.where(file["WEIGHT"].data > 0, file["SIGNAL"].data, np.nan)


def other_words(file):
    for image in file[1:]:
        for key in ("CUNIT1", "CUNIT2", "LONPOLE", "LATPOLE", "RADESYS"):
            del image.header[key]
        image.header.update({"RADESYS": "FK5", "EQUINOX": 2000.0, "PC1_1": 1.0, "CROTA2": 0.0, "HISTORY": "copied"})


RIGHT_MAPS = {
    "other words": other_words,
    "compressed": compressed,
    "double": set_data("SIGNAL", lambda a: a.astype(float)),
    "short": set_data("HITS", lambda a: a.astype(np.int16)),
    "unsigned": set_data("HITS", lambda a: a.astype(np.uint16)),  # FITS has it scaled, with BZERO
    "hits in floats": set_data("HITS", lambda a: a.astype(np.float32)),
    "NaN outside": nan_where_nothing_was_observed,
}


@pytest.mark.parametrize("kind", RIGHT_MAPS)
def test_maps_of_other_types(map_path, kind):
    before = read_fits(map_path)
    change_map(map_path, RIGHT_MAPS[kind])
    same_map(read_fits(map_path), before)


def test_scaled_and_zipped_maps(map_path, tmp_path):
    import gzip

    before = read_fits(map_path)
    (tmp_path / "map.fits.gz").write_bytes(gzip.compress(map_path.read_bytes()))
    same_map(read_fits(tmp_path / "map.fits.gz"), before)

    with fits.open(map_path, memmap=False) as file:
        file = fits.HDUList([hdu.copy() for hdu in file])
    file["WEIGHT"] = fits.ImageHDU(file["WEIGHT"].data.astype(float), file["WEIGHT"].header, name="WEIGHT")
    file["WEIGHT"].scale("int16", bscale=0.2, bzero=0.0)
    file.writeto(map_path, overwrite=True)
    with fits.open(map_path, do_not_scale_image_data=True) as stored:
        assert stored["WEIGHT"].data.dtype == ">i2" and stored["WEIGHT"].header["BSCALE"] == 0.2
    same_map(read_fits(map_path), before)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.filterwarnings("ignore")
def test_mangled_maps(map_path, seed):
    rng, whole = np.random.default_rng(seed), map_path.read_bytes()
    for _ in range(8):
        mangled = bytearray(whole)
        for place in rng.integers(0, len(whole), 6):
            mangled[place] = rng.integers(0, 256)
        map_path.write_bytes(mangled[: rng.integers(0, len(whole))] if rng.random() < 0.3 else mangled)
        try:
            item = read_fits(map_path)
            assert np.isfinite(item.weighted_sum).all() and (item.weight >= 0).all()
        except ValueError as error:
            assert str(error).startswith(f"{map_path}: ") and "\n" not in str(error) and len(str(error)) < 500


@pytest.mark.parametrize("unit", ["count", "mK-2"])
def test_unit_of_weights_survives(unit, tmp_path):
    """Through two files, and none of the two becomes the other."""
    write_fits(tmp_path / "a.fits", a_map(unit), {})
    once = read_fits(tmp_path / "a.fits")
    write_fits(tmp_path / "b.fits", once, {})
    assert fits.getheader(tmp_path / "b.fits", "WEIGHT")["BUNIT"] == unit == read_fits(tmp_path / "b.fits").weight_unit
    assert half_difference(once, once).weight_unit == unit
    with pytest.raises(ValueError, match="maps of one unit are expected"):
        half_difference(once, replace(once, weight_unit="count" if unit == "mK-2" else "mK-2"))


def test_unit_of_weights_follows_their_content():
    index = np.zeros((1, 4), np.int32)
    binned = bin_map(GEOMETRY, np.ones((1, 4)), index, np.array([[0, 4]]), kept=np.array([True]))
    assert binned.weight_unit == "count" and coadd([binned], [0.2]).weight_unit == "mK-2"


@pytest.mark.parametrize("header", [{"A" * 90: "\n"}, {"OBJECT": object()}, {"OBJECT": [1, 2]}, {"OBJECT": "ä\n"}])
def test_headers_that_fits_cannot_hold(header, tmp_path):
    with pytest.raises(ValueError, match="header: found .*; a card of FITS is expected"):
        write_fits(tmp_path / "map.fits", a_map(), header)
    assert not list(tmp_path.iterdir())


def test_values_beyond_single_precision(tmp_path):
    item = a_map()
    with pytest.raises(ValueError, match="weight: .* single precision"):
        write_fits(tmp_path / "map.fits", replace(item, weight=item.weight * 1e39), {})
    assert not list(tmp_path.iterdir())
