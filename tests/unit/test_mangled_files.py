"""Readers of time-streams and maps: what files may hold, and what is refused by file and fault in one line."""

import os
import threading
from dataclasses import replace

import h5py
import numpy as np
import pytest
from astropy.io import fits

from mapmaker.binning import BinnedMap, bin_map, coadd, half_difference, read_fits, write_fits
from mapmaker.geometry import MapGeometry
from mapmaker.timestreams import FocalPlane, Timestreams, read_timestreams, timestream_file, write_timestreams

N_DET, N_SAMP = 4, 50
GEOMETRY = MapGeometry(*np.radians([0.0, -30.0]), np.radians(30 / 3600), 12, 9)
RNG = np.random.default_rng(6)


def streams():
    plane = FocalPlane(*RNG.normal(0, 1e-3, (2, N_DET)), 2.9e-4)
    ra, dec, angle = 2 * np.pi - 0.01 + np.linspace(0, 0.02, N_SAMP), np.full(N_SAMP, -0.5), np.zeros(N_SAMP)
    scan = np.repeat([100, -1, 101, 102, -1], 10)
    data = RNG.standard_normal((N_DET, N_SAMP), dtype=np.float32)
    return Timestreams(data, np.arange(N_SAMP) / 10, ra, dec, angle, scan, plane, {"seed": 7})


@pytest.fixture
def path(tmp_path):
    write_timestreams(tmp_path / "one.h5", streams())
    return tmp_path / "one.h5"


def put(path, name, values, **options):
    with h5py.File(path, "a") as file:
        del file[name]
        file.create_dataset(name, data=values, **options)


def get(path, name):
    with h5py.File(path) as file:
        return file[name][()]


def refused(read, path, words):
    before = path.read_bytes() if path.is_file() else None
    with pytest.raises(ValueError, match=words) as caught:
        read(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ") and "\n" not in text and len(text) < len(str(path)) + 300
    assert before is None or path.read_bytes() == before


WRONG_VALUES = {
    "text": lambda v: v.astype("S8"),
    "letters of any length": lambda v: v.astype(str).astype(object),
    "complex": lambda v: v.astype(complex),
    "records": lambda v: np.zeros(v.shape, [("a", "f4"), ("b", "i4")]),
    "flags": lambda v: v > 0,
    "one value": lambda v: v.ravel()[0],
    "nothing": lambda v: v[:0],
    "another axis": lambda v: v[None],
}


@pytest.mark.parametrize("kind", WRONG_VALUES)
@pytest.mark.parametrize("name", ["data", "ra_deg", "scan", "x_arcmin"])
def test_types_and_shapes_of_streams(path, name, kind):
    values = WRONG_VALUES[kind](get(path, name))
    if isinstance(values, np.ndarray) and values.dtype == object:
        put(path, name, values, dtype=h5py.string_dtype())
    elif kind == "flags" and name != "scan":
        values = values.astype("S5")
        put(path, name, values)
    else:
        put(path, name, values)
    refused(read_timestreams, path, "found|shape|whole|values")


@pytest.mark.parametrize("name", ["time_s", "ra_deg", "dec_deg", "array_angle_deg", "x_arcmin", "y_arcmin"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300])
def test_pointing_that_is_none(path, name, value):
    values = get(path, name)
    values[-2] = value
    put(path, name, values)
    refused(read_timestreams, path, name)


def test_times_and_declinations(path):
    for name, values in (("time_s", get(path, "time_s")[::-1]), ("dec_deg", np.full(N_SAMP, 90.1))):
        before = get(path, name)
        put(path, name, values)
        refused(read_timestreams, path, name)
        put(path, name, before)
    read_timestreams(path)


@pytest.mark.parametrize("value", [0.0, -60.0, np.nan, np.inf, "60", "wide", [60.0, 60.0], 1j, h5py.Empty("f8")])
def test_beams(path, value):
    with h5py.File(path, "a") as file:
        file.attrs["fwhm_arcsec"] = value
    refused(read_timestreams, path, "fwhm_arcsec|fwhm_rad")


@pytest.mark.parametrize(
    "scan, words",
    [
        (np.repeat([0, 1, 0, -1, 2], 10), "scan 0 in 2 pieces"),
        (np.repeat([5, -1, 5, -1, 5], 10), "scan 5 in 3 pieces"),
        (np.repeat([0, 255, 1, 2, 255], 10).astype(np.uint8), "255, which is -1 in the type uint8"),
        (np.repeat([0, 65535, 1, 2, 65535], 10).astype(">u2"), "65535, which is -1 in the type"),
        (np.repeat([0, 2**32 - 1, 1, 2, 3], 10).astype(np.uint32), "4294967295, which is -1"),
        (np.repeat(np.array([0, 2**64 - 1, 1, 2, 3], np.uint64), 10), "scan: found 18446744073709551615"),
        (np.repeat([0.0, np.nan, 1.0, 2.0, 3.0], 10), "integers are expected"),
        (np.repeat([0.0, -1.0, 1.0, 2.0, 3.0], 10), "integers are expected"),
    ],
)
def test_scans(path, scan, words):
    put(path, "scan", scan)
    refused(read_timestreams, path, words)


@pytest.mark.parametrize("kind", ["u1", "i1", ">i2", "<i8", ">u4"])
def test_scans_of_any_integers(path, kind):
    scan = np.repeat([7, 8, 9, 120, 121], 10)
    put(path, "scan", scan.astype(kind))
    again = read_timestreams(path)
    np.testing.assert_array_equal(again.scan, scan)
    assert again.scan.dtype.kind == "i" and again.scan.dtype.isnative and len(again.scan_bounds) == 5


@pytest.mark.parametrize("kind", [">f4", ">f8", "<i2", ">i4", "u1", "f2"])
def test_numbers_of_any_real_type(path, kind):
    numbers = np.rint(np.abs(get(path, "data")) * 40)
    put(path, "data", numbers.astype(kind), compression="gzip")
    put(path, "x_arcmin", np.array([-3, 0, 2, 5], ">i2"))
    again = read_timestreams(path)
    np.testing.assert_array_equal(again.data_mk, numbers)
    assert again.data_mk.dtype == (np.float32 if kind == ">f4" else np.float64) and again.data_mk.dtype.isnative
    np.testing.assert_allclose(again.focal_plane.x_rad, np.radians(np.array([-3, 0, 2, 5]) / 60))


def test_data_may_be_nan(path):
    data = get(path, "data")
    data[1, 4:7] = np.nan
    put(path, "data", data)
    np.testing.assert_array_equal(read_timestreams(path).data_mk, data)


def test_groups_links_and_files_elsewhere(path, tmp_path):
    def group(file):
        file.create_group("data")

    def link(file):
        file["data"] = h5py.ExternalLink(tmp_path / "other.h5", "data")

    def nowhere(file):
        file["data"] = h5py.SoftLink("/nowhere")

    def external(file):
        file.create_dataset("data", (N_DET, N_SAMP), "f4", external=[(str(tmp_path / "raw"), 0, N_DET * N_SAMP * 4)])

    def virtual(file):
        layout = h5py.VirtualLayout((N_DET, N_SAMP), "f4")
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "data", (N_DET, N_SAMP))
        file.create_virtual_dataset("data", layout)

    def empty(file):
        file.create_dataset("data", dtype="f4")

    def never_written(file):
        file.create_dataset("data", (10**6, N_SAMP), "f4")

    whole = path.read_bytes()
    for make in (group, link, nowhere, external, virtual, empty, never_written):
        path.write_bytes(whole)
        with h5py.File(path, "a") as file:
            del file["data"]
            make(file)
        refused(read_timestreams, path, "data")


@pytest.mark.parametrize("read", [read_timestreams, read_fits])
def test_pipes_devices_and_folders(read, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "empty").touch()
    failed = []

    def check():
        try:
            for name in ("pipe", "folder", "loop", "empty", "nowhere"):
                refused(read, tmp_path / name, "not a whole")
            with pytest.raises(ValueError, match="/dev/zero: not a whole .* file .no regular file"):
                read("/dev/zero")
        except BaseException as error:
            failed.append(error)

    thread = threading.Thread(target=check, daemon=True)
    thread.start()
    thread.join(20)
    assert not thread.is_alive() and not failed, failed


@pytest.mark.parametrize("seed", range(6))
def test_mangled_streams(path, seed):
    """Some bytes of the structure are others, or the file ends early: an error of one line, or what it held."""
    rng, whole = np.random.default_rng(seed), path.read_bytes()
    for _ in range(8):
        mangled = bytearray(whole)
        for place in rng.integers(0, len(whole), 12):
            mangled[place] = rng.integers(0, 256)
        path.write_bytes(mangled[: rng.integers(len(whole) // 4, len(whole))] if rng.random() < 0.3 else mangled)
        try:
            assert np.isfinite(read_timestreams(path).ra_rad).all()
        except ValueError as error:
            assert str(error).startswith(f"{path}: ") and "\n" not in str(error) and len(str(error)) < 500


def test_parts_of_other_detectors_are_refused(tmp_path):
    made = streams()
    with (
        pytest.raises(ValueError, match="2 detectors after 4"),
        timestream_file(tmp_path / "a.h5", 2 * N_SAMP) as add,
    ):
        add(made)
        add(made.subset([0, 1]))
    with pytest.raises(ValueError, match="found 100 samples; 60"), timestream_file(tmp_path / "a.h5", 60) as add:
        add(made)
        add(made)
    with pytest.raises(ValueError, match="fwhm_arcsec; the beam in focal_plane"):
        write_timestreams(tmp_path / "a.h5", replace(made, attributes={"fwhm_arcsec": 5.0}))
    with pytest.raises(ValueError, match="data_mk: .* single precision"):
        write_timestreams(tmp_path / "a.h5", replace(made, data_mk=made.data_mk.astype(float) * 1e39))
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- maps


def a_map(unit="mK-2"):
    hits = RNG.integers(0, 5, (GEOMETRY.n_y, GEOMETRY.n_x))
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


RIGHT_MAPS = {
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
    binned = bin_map(GEOMETRY, np.ones((1, 4)), index, np.array([[0, 4]]), np.array([True]))
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
