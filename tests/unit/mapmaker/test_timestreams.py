from dataclasses import replace

import h5py
import numpy as np
import pytest

from mapmaker.errors import InputError
from mapmaker.formats import read_timestreams, write_timestreams
from mapmaker.formats.hdf5 import timestream_file
from mapmaker.timestreams import FocalPlane, Timestreams, scan_bounds

N_DET, N_SAMP = 5, 60
NAMES = ("data", "time_s", "ra_deg", "dec_deg", "array_angle_deg", "scan", "x_arcmin", "y_arcmin")
ROUNDING = 1e-14  # degrees or arcmin to radians and back


@pytest.fixture
def streams():
    rng = np.random.default_rng(1)
    plane = FocalPlane(*rng.normal(0, 1e-3, (2, N_DET)), 2.9e-4)
    ra, dec, angle = rng.uniform(0.2, 1.5, (3, N_SAMP))
    scan = np.repeat([-1, 0, -1, 1, 2, -1], 10)
    data = rng.standard_normal((N_DET, N_SAMP), dtype=np.float32)
    return Timestreams(
        data,
        np.arange(N_SAMP) / 10,
        ra,
        dec,
        angle,
        scan,
        plane,
        {"seed": 7, "scene": "small", "b2_mk2": 280.5},
    )


@pytest.fixture
def path(tmp_path, streams):
    path = tmp_path / "made" / "on the way" / "0001.h5"
    write_timestreams(path, streams)
    return path


def test_round_trip(path, streams):
    again = read_timestreams(path)
    np.testing.assert_array_equal(again.data_mk, streams.data_mk)
    assert again.data_mk.dtype == np.float32 and again.data_mk.flags.c_contiguous
    np.testing.assert_array_equal(again.time_s, streams.time_s)
    np.testing.assert_array_equal(again.scan, streams.scan)
    for name in ("ra_rad", "dec_rad", "array_angle_rad"):
        np.testing.assert_allclose(getattr(again, name), getattr(streams, name), rtol=ROUNDING)
    for name in ("x_rad", "y_rad", "fwhm_rad"):
        expected = getattr(streams.focal_plane, name)
        np.testing.assert_allclose(getattr(again.focal_plane, name), expected, rtol=ROUNDING)
    assert dict(again.attributes) == dict(streams.attributes)
    np.testing.assert_array_equal(again.scan_bounds, streams.scan_bounds)


def part(streams, samples):
    """Some samples of all detectors."""
    names = ("time_s", "ra_rad", "dec_rad", "array_angle_rad", "scan")
    return replace(
        streams, data_mk=streams.data_mk[:, samples], **{name: getattr(streams, name)[samples] for name in names}
    )


def test_names_are_optional(path, streams, tmp_path):
    """As polarization angles are; letters of any alphabet."""
    assert read_timestreams(path).focal_plane.names is None
    names = np.array(["a1", "b\u00e92", "c", "d_long_name", "e"])
    plane = replace(streams.focal_plane, names=names)
    write_timestreams(tmp_path / "named.h5", replace(streams, focal_plane=plane))
    assert read_timestreams(tmp_path / "named.h5").focal_plane.names.tolist() == names.tolist()
    assert plane.subset(np.array([2, 0])).names.tolist() == ["c", "a1"]
    for wrong in (names[1:], np.arange(N_DET)):
        with pytest.raises(ValueError, match="names: found .* 5 texts are expected"):
            replace(streams.focal_plane, names=wrong)


@pytest.mark.parametrize("values", [np.arange(N_DET), np.arange(N_DET) * 1.5, np.array([b"\xff"] * N_DET)])
def test_names_that_are_no_texts_are_refused(path, values):
    with h5py.File(path, "a") as file:
        file["detector_name"] = values
    with pytest.raises(InputError, match=f"^{path}: "):
        read_timestreams(path)


def test_polarization_angles_are_optional(path, streams, tmp_path):
    """A file without them has none; a file with them has those of each detector, as its subsets do."""
    assert read_timestreams(path).focal_plane.angle_rad is None
    angle = np.radians(np.arange(N_DET) * 30.0 - 90)
    plane = replace(streams.focal_plane, angle_rad=angle)
    write_timestreams(tmp_path / "polarized.h5", replace(streams, focal_plane=plane))
    np.testing.assert_allclose(read_timestreams(tmp_path / "polarized.h5").focal_plane.angle_rad, angle, atol=1e-12)
    np.testing.assert_array_equal(plane.subset(slice(1, 3)).angle_rad, angle[1:3])
    with pytest.raises(ValueError, match="angle_rad"):
        replace(streams.focal_plane, angle_rad=angle[1:])


def test_parts_make_the_same_file(path, streams, tmp_path):
    with timestream_file(tmp_path / "parts.h5", N_SAMP) as add:
        for samples in (slice(0, 7), slice(7, 30), slice(30, N_SAMP)):
            add(part(streams, samples))
    with h5py.File(path) as whole, h5py.File(tmp_path / "parts.h5") as parts:
        for name in NAMES:
            np.testing.assert_array_equal(whole[name][()], parts[name][()])
            assert whole[name].dtype == parts[name].dtype
        assert dict(whole.attrs) == dict(parts.attrs)


def test_a_file_that_lacks_a_part_is_none(streams, tmp_path):
    file = tmp_path / "half.h5"
    said = "half.h5: found 30 samples; 60 are expected"
    with pytest.raises(ValueError, match=said), timestream_file(file, N_SAMP) as add:
        add(part(streams, slice(0, 30)))
    assert not list(tmp_path.iterdir())


def test_file_says_its_units(path, streams):
    with h5py.File(path) as file:
        assert set(file) == set(NAMES)
        assert file["data"].attrs["unit"] == "mK (Rayleigh-Jeans)"
        assert file.attrs["fwhm_arcsec"] == pytest.approx(np.degrees(streams.focal_plane.fwhm_rad) * 3600)
        np.testing.assert_allclose(np.radians(file["ra_deg"][()]), streams.ra_rad, rtol=ROUNDING)


def test_double_streams_are_stored_in_single_precision(tmp_path, streams):
    double = replace(streams, data_mk=streams.data_mk.astype(float) + 1e-12)
    write_timestreams(tmp_path / "a.h5", double)
    np.testing.assert_array_equal(read_timestreams(tmp_path / "a.h5").data_mk, double.data_mk.astype(np.float32))


def test_nothing_partial_is_left(path, streams):
    assert [item.name for item in path.parent.iterdir()] == ["0001.h5"]
    write_timestreams(path, replace(streams, data_mk=streams.data_mk + 1))
    assert [item.name for item in path.parent.iterdir()] == ["0001.h5"]
    np.testing.assert_array_equal(read_timestreams(path).data_mk, streams.data_mk + 1)


def test_a_failed_write_leaves_the_file_as_it_was(path, streams):
    before = path.read_bytes()
    with pytest.raises(ValueError, match="truth.*found object; numbers and texts are expected"):
        write_timestreams(path, replace(streams, attributes={"truth": object()}))
    assert path.read_bytes() == before


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.99])
def test_a_truncated_file_is_refused(path, share):
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ValueError, match="not a whole time-stream file") as caught:
        read_timestreams(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(ValueError, match="nowhere.h5: no such file; a time-stream file is expected"):
        read_timestreams(tmp_path / "nowhere.h5")


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_data_set_is_refused(path, name):
    with h5py.File(path, "a") as file:
        del file[name]
    with pytest.raises(ValueError, match=f"lacks {name}") as caught:
        read_timestreams(path)
    assert str(path) in str(caught.value)


def test_a_missing_beam_is_refused(path):
    with h5py.File(path, "a") as file:
        del file.attrs["fwhm_arcsec"]
    with pytest.raises(ValueError, match="lacks the attribute fwhm_arcsec"):
        read_timestreams(path)


@pytest.mark.parametrize("name", NAMES[1:])
def test_a_wrong_shape_is_refused(path, name):
    with h5py.File(path, "a") as file:
        values = file[name][()]
        del file[name]
        file[name] = values[:-1]
    with pytest.raises(ValueError, match=f"{name} has the shape .* is expected") as caught:
        read_timestreams(path)
    assert str(path) in str(caught.value)
    assert str((len(values) - 1,)) in str(caught.value) and str((len(values),)) in str(caught.value)


def test_data_of_one_dimension_are_refused_by_name(path):
    with h5py.File(path, "a") as file:
        del file["data"]
        file["data"] = np.zeros(N_SAMP)
    with pytest.raises(ValueError, match="data") as caught:
        read_timestreams(path)
    assert str(path) in str(caught.value)


@pytest.mark.parametrize(
    "scan, bounds",
    [
        ([0, 0, 0], [[0, 3]]),
        ([0, 0, 1, 1, 1], [[0, 2], [2, 5]]),
        ([-1, 0, 0, -1, -1, 1, -1], [[1, 3], [5, 6]]),
        ([3, 3, -1, 7, 7, 8], [[0, 2], [3, 5], [5, 6]]),
        ([-1, -1], []),
    ],
)
def test_scan_bounds(scan, bounds):
    found = scan_bounds(np.array(scan))
    assert found.dtype == np.int64 and found.shape == (len(bounds), 2)
    np.testing.assert_array_equal(found, np.reshape(bounds, (-1, 2)))


def test_subset_of_a_focal_plane(streams):
    some = streams.focal_plane.subset(np.array([3, 1]))
    np.testing.assert_array_equal(some.x_rad, streams.focal_plane.x_rad[[3, 1]])
    np.testing.assert_array_equal(some.y_rad, streams.focal_plane.y_rad[[3, 1]])
    assert some.fwhm_rad == streams.focal_plane.fwhm_rad
