"""Reader of time-streams: what files may hold, and what is refused by file and fault in one line."""

import os
import threading
from dataclasses import replace

import h5py
import numpy as np
import pytest

from mapmaker.binning import read_fits
from mapmaker.formats import read_timestreams, write_timestreams
from mapmaker.formats.hdf5 import timestream_file
from mapmaker.timestreams import FocalPlane, Timestreams
from tests.refusals import refused

N_DET, N_SAMP = 4, 50
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


WRONG_VALUES = {
    "text": lambda v: v.astype("S8"),
    "letters of any length": lambda v: v.astype(str).astype(object),
    "complex": lambda v: v.astype(complex),
    "records": lambda v: np.zeros(v.shape, [("a", "f4"), ("b", "i4")]),
    "flags": lambda v: v > 0,
    "names": lambda v: v.astype("i4"),
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
    elif kind == "names":
        put(path, name, values, dtype=h5py.enum_dtype({"low": 0, "high": 1}, "i4"))
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


@pytest.mark.parametrize(
    "value", [0.0, -60.0, np.nan, np.inf, 648000.0, 1e300, "60", "wide", [60.0, 60.0], 1j, h5py.Empty("f8")]
)
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
            refused(read, tmp_path / "pipe", "no regular file; a .* file is expected")
            refused(read, tmp_path / "folder", "found a directory; a .* file is expected")
            refused(read, tmp_path / "nowhere", "no such file; a .* file is expected")
            refused(read, tmp_path / "loop", "no such file; a .* file is expected")
            refused(read, tmp_path / "empty", "not a whole")
            with pytest.raises(ValueError, match="/dev/zero: no regular file; a .* file is expected"):
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
