"""Formats of time-streams: versions, recognition by content, round trips, what is lost, wrong files of each."""

import sys
import warnings
from dataclasses import replace

import h5py
import numpy as np
import pytest
from astropy.io import fits

import mapmaker as mm
from mapmaker.errors import InputError
from mapmaker.formats import FORMATS, file_format, toast
from tests.exchange.streams import ARCSEC, N_DET, N_SAMP, apart, sights, streams
from tests.refusals import refused

MADE = streams(flagged=True)
SUFFIXES = {"hdf5": "one.h5", "toast": "one.toast.h5", "mustang2": "one.fits"}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of a good file of each format that needs no further library."""
    folder = tmp_path_factory.mktemp("whole")
    with warnings.catch_warnings(action="ignore"):
        for name in SUFFIXES.values():
            mm.write_timestreams(folder / name, MADE)
    return {format: (folder / name).read_bytes() for format, name in SUFFIXES.items()}


@pytest.fixture
def file_of(whole, tmp_path):
    def copied(format):
        path = tmp_path / "some file"
        path.write_bytes(whole[format])
        return path

    return copied


@pytest.mark.parametrize("format", SUFFIXES)
def test_round_trip(file_of, format):
    """Positions, signal, flags and scans; the format is recognized without a suffix."""
    path = file_of(format)
    assert file_format(path).name == format
    again = mm.read_timestreams(path)
    assert apart(sights(again), sights(MADE)) < 1e-4 * ARCSEC
    np.testing.assert_allclose(again.data_mk, MADE.data_mk, rtol=1e-15)
    np.testing.assert_array_equal(again.flags, MADE.flags)
    np.testing.assert_array_equal(again.scan, MADE.scan)
    np.testing.assert_array_equal(again.time_s, MADE.time_s)
    assert again.focal_plane.fwhm_rad == pytest.approx(MADE.focal_plane.fwhm_rad, rel=1e-15)
    if format == "mustang2":
        assert again.focal_plane.names.tolist() == [str(number) for number in range(N_DET)]
    else:
        turned = np.array([again.ra_rad - MADE.ra_rad, again.array_angle_rad - MADE.array_angle_rad])
        np.testing.assert_allclose(np.exp(1j * turned), 1, rtol=1e-13)
        np.testing.assert_allclose(again.focal_plane.angle_rad, MADE.focal_plane.angle_rad, rtol=1e-14)
        np.testing.assert_array_equal(again.focal_plane.names, MADE.focal_plane.names)
        assert dict(again.attributes) == dict(MADE.attributes)


@pytest.mark.parametrize("format", SUFFIXES)
def test_another_beam(file_of, format):
    assert mm.read_timestreams(file_of(format), fwhm_rad=1e-3).focal_plane.fwhm_rad == 1e-3
    with pytest.raises(ValueError, match="fwhm_rad: found -1.0"):
        mm.read_timestreams(file_of(format), fwhm_rad=-1.0)


def test_losses_are_told(tmp_path):
    always = "one.fits: format mustang2 does not hold the boresight and the zero point of the array angle"
    with pytest.warns(UserWarning, match=f"{always}, names of detectors, polarization angles, attributes$"):
        mm.write_timestreams(tmp_path / "one.fits", MADE)
    plain = replace(MADE, focal_plane=replace(MADE.focal_plane, angle_rad=None, names=None), attributes={})
    with pytest.warns(UserWarning, match=f"{always}$"):
        mm.write_timestreams(tmp_path / "one.fits", plain)
    with warnings.catch_warnings(action="error"):
        for name in ("one.h5", "one.hdf5", "one.toast.h5"):
            mm.write_timestreams(tmp_path / name, MADE)


def test_names_and_order_of_pixels(tmp_path):
    """Numbers as names, in any order, and none at all."""
    names = np.array(["40", "3", "17", "5", "6", "70", "1"])
    named = replace(MADE, focal_plane=replace(MADE.focal_plane, names=names))
    with warnings.catch_warnings(action="ignore"):
        mm.write_timestreams(tmp_path / "one.fits", named)
    again = mm.read_timestreams(tmp_path / "one.fits")
    assert again.focal_plane.names.tolist() == names.tolist()
    np.testing.assert_allclose(again.data_mk, MADE.data_mk, rtol=1e-15)
    unnamed = replace(MADE, focal_plane=replace(MADE.focal_plane, names=None))
    mm.write_timestreams(tmp_path / "one.toast.h5", unnamed)
    assert mm.read_timestreams(tmp_path / "one.toast.h5").focal_plane.names.tolist() == [f"D{k}" for k in range(N_DET)]
    twice = replace(MADE, focal_plane=replace(MADE.focal_plane, names=np.array(["a"] * N_DET)))
    with pytest.raises(InputError, match="found 7 detectors of the name a; one each is expected"):
        mm.write_timestreams(tmp_path / "two.toast.h5", twice)
    assert not (tmp_path / "two.toast.h5").exists()


def test_tables_are_those_of_minkasi(file_of):
    """Rows detector by detector, radians, kelvins, and lost samples by their uncertainty, as its reader takes them."""
    with fits.open(file_of("mustang2")) as file:
        raw = file[1].data
        detectors = np.unique(raw["PIXID"])
        cut = {
            name: np.reshape(raw[name], (len(detectors), -1)) for name in ("DX", "DY", "TIME", "FNU", "UFNU", "PIXID")
        }
    np.testing.assert_array_equal(cut["PIXID"][:, 0], detectors)
    np.testing.assert_array_equal(cut["TIME"][0], MADE.time_s)
    np.testing.assert_allclose(cut["FNU"] * 1e3, MADE.data_mk, rtol=1e-15)
    np.testing.assert_array_equal(cut["UFNU"] < 9e5, ~MADE.flags)
    ra, dec = cut["DX"], cut["DY"]
    found = np.moveaxis([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], 0, -1)
    assert apart(found, sights(MADE)) < 1e-4 * ARCSEC


@pytest.mark.parametrize("format", SUFFIXES)
def test_one_detector_one_scan_and_no_scan(tmp_path, format):
    with warnings.catch_warnings(action="ignore"):
        for made in (
            MADE.subset([3]),
            replace(MADE, scan=np.full(N_SAMP, -1)),
            replace(MADE, scan=np.zeros(N_SAMP, int)),
        ):
            mm.write_timestreams(tmp_path / SUFFIXES[format], made)
            again = mm.read_timestreams(tmp_path / SUFFIXES[format])
            np.testing.assert_array_equal(again.scan, made.scan)
            assert apart(sights(again), sights(made)) < 1e-4 * ARCSEC


def test_unknown_formats(tmp_path):
    with pytest.raises(InputError, match="format: found 'csv'; one of toast, hdf5, g3, mustang2 is expected"):
        mm.write_timestreams(tmp_path / "one.h5", MADE, format="csv")
    with pytest.raises(
        InputError, match="one.csv: found no format and no known suffix; one of .toast.h5, .h5, .hdf5, "
    ):
        mm.write_timestreams(tmp_path / "one.csv", MADE)
    (tmp_path / "one.csv").write_text("a,b")
    refused(mm.read_timestreams, tmp_path / "one.csv", "format unknown; known are toast, hdf5, g3, mustang2")
    assert [item.name for item in tmp_path.iterdir()] == ["one.csv"]


def test_versions(file_of):
    """Files without a version are read, newer ones are not."""
    path = file_of("hdf5")
    with h5py.File(path, "a") as file:
        assert (file.attrs["format"], file.attrs["format_version"]) == ("mapmaker time-streams", 1)
        file.attrs["format_version"] = 2
    refused(
        mm.read_timestreams, path, "the attribute format_version: found 2; an integer of at least 1 and of at most 1 is"
    )
    with h5py.File(path, "a") as file:
        del file.attrs["format_version"]
    refused(mm.read_timestreams, path, "lacks the attribute format_version")
    with h5py.File(path, "a") as file:
        file.attrs["format"] = "another"
    refused(mm.read_timestreams, path, "the attribute format: found another; 'mapmaker time-streams' is expected")
    with h5py.File(path, "a") as file:
        del file.attrs["format"]
    assert dict(mm.read_timestreams(path).attributes) == dict(MADE.attributes)


def test_g3_without_its_library(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "spt3g", None)
    monkeypatch.setitem(__import__("sys").modules, "so3g", None)
    words = "G3 frames need spt3g: pip install 'mmcam-surveysim[g3]'"
    with pytest.raises(InputError) as caught:
        mm.write_timestreams(tmp_path / "one.g3", MADE)
    assert str(caught.value) == f"{tmp_path / 'one.g3'}: {words}"
    (tmp_path / "two.g3").write_bytes(b"\x01\x01\0\0\0\x04\0\0\0O\0\0\0")
    with pytest.raises(InputError) as caught:
        mm.read_timestreams(tmp_path / "two.g3")
    assert str(caught.value) == f"{tmp_path / 'two.g3'}: {words}"


def of_toast(name, **options):
    """Change a data set of a TOAST file; without options, remove it."""

    def change(path):
        with h5py.File(path, "a") as file:
            units = dict(file[name].attrs)
            values = options["to"](file[name][()]) if options else None
            del file[name]
            if options:
                file[name] = values
                file[name].attrs.update(units)

    return change


def attribute(name, value, group="/"):
    def change(path):
        with h5py.File(path, "a") as file:
            file[group].attrs[name] = value

    return change


def of_table(change_table):
    """Change the table of the detectors."""

    def change(path):
        from astropy.table import QTable

        with h5py.File(path, "a") as file:
            table = change_table(QTable.read(file["instrument"], path="focalplane"))
            for name in list(file["instrument"]):
                del file["instrument"][name]
            table.write(file["instrument"], path="focalplane", format="hdf5", serialize_meta=True)

    return change


def without(name):
    def change(table):
        table.remove_column(name)
        return table

    return change


def put(index, value):
    def change(values):
        values[index] = value
        return values

    return change


def backwards(table):
    table["quat"] = table["quat"][:, [2, 3, 0, 1]]  # turned by half a turn about the x axis
    return table


WRONG_TOAST = {
    "a newer version": (attribute("toast_format_version", 3), "toast_format_version: found 3; 1 to 2 is expected"),
    "no detectors": (attribute("observation_detectors", "["), "not a whole time-stream file"),
    "other detectors": (attribute("observation_detectors", '["a", "b"]'), r"detdata/flags has the shape \(7, 600\)"),
    "no signal": (of_toast("detdata/signal"), "lacks signal"),
    "watts": (attribute("units", "W", "detdata/signal"), "the unit of detdata/signal: found 'W'; K, mK or uK is"),
    "a short signal": (of_toast("detdata/signal", to=lambda v: v[:, 1:]), r"detdata/signal has the shape \(7, 599\)"),
    "text": (of_toast("detdata/signal", to=lambda v: v.astype("S8")), "detdata/signal: found the type"),
    "no times": (of_toast("shared/times"), "lacks shared/times"),
    "times backwards": (of_toast("shared/times", to=lambda v: v[::-1]), "shared/times: found"),
    "no boresight": (of_toast("shared/boresight_radec"), "lacks shared/boresight_radec"),
    "NaN in the boresight": (of_toast("shared/boresight_radec", to=put((5, 2), np.nan)), "boresight_radec: found nan"),
    "no rotations": (of_toast("shared/boresight_radec", to=lambda v: v / 2), "found a quaternion of the length 0.5"),
    "scans that overlap": (of_toast("intervals/scanning", to=lambda v: v[:, ::-1]), "overlap or are not in order"),
    "scans without ends": (of_toast("intervals/scanning", to=lambda v: v[:1]), "intervals/scanning: found the shape"),
    "numbers of other scans": (of_toast("metadata/other/scan_numbers", to=lambda v: v[1:]), "scan_numbers: found the"),
    "no table": (of_toast("instrument/focalplane"), "lacks focalplane"),
    "no beam": (of_table(without("fwhm")), "instrument/focalplane lacks the column fwhm"),
    "no places": (of_table(without("quat")), "instrument/focalplane lacks the column quat"),
    "no such detector": (of_table(lambda table: table[1:]), "instrument/focalplane lacks the detector 'd0'"),
    "behind": (of_table(backwards), "the column quat of instrument/focalplane: found a detector a quarter of a turn"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_TOAST)
def test_wrong_toast_files(file_of, case):
    change, words = WRONG_TOAST[case]
    path = file_of("toast")
    change(path)
    refused(mm.read_timestreams, path, words)


def compressed(path, change=lambda group: None):
    """Compress signal and flags as TOAST does."""
    flacarray = pytest.importorskip("flacarray.hdf5")
    with h5py.File(path, "r+") as file:
        for name, kind, options in (("signal", np.float64, {"precision": 6}), ("flags", np.int32, {})):
            values, unit = file[f"detdata/{name}"][()].astype(kind), file[f"detdata/{name}"].attrs["units"]
            del file[f"detdata/{name}"]
            item = file.create_group(f"detdata/{name}")
            item.attrs["units"] = unit
            flacarray.write_array(np.nan_to_num(values), item, **options)
        change(file["detdata/signal"])


def test_compressed_toast_files(file_of):
    path = file_of("toast")
    expected = mm.read_timestreams(path)
    compressed(path)
    found = mm.read_timestreams(path)
    np.testing.assert_array_equal(found.flags, expected.flags)
    expected_mk = np.nan_to_num(expected.data_mk)
    np.testing.assert_allclose(found.data_mk, expected_mk, atol=1e-5 * expected_mk.std())
    with h5py.File(path, "r+") as file:
        file["detdata/signal/stream_bytes"][2] += 1
    refused(mm.read_timestreams, path, "detdata/signal has streams beyond its")


@pytest.mark.parametrize(
    "version, words", [("1", "is compressed: pip install 'mmcam-surveysim.toast.'"), ("0", "in an old format; load it")]
)
def test_compressed_toast_files_that_cannot_be_read(file_of, monkeypatch, version, words):
    monkeypatch.setitem(sys.modules, "flacarray.hdf5", None)
    path = file_of("toast")
    with h5py.File(path, "r+") as file:
        del file["detdata/signal"]
        file.create_group("detdata/signal").attrs["flacarray_format_version"] = version
    refused(mm.read_timestreams, path, words)


def test_other_toast_files(file_of):
    """Units, one scan without intervals, flags of TOAST and of whole detectors, and detectors in another order."""
    path = file_of("toast")
    attribute("units", "uK", "detdata/signal")(path)
    of_toast("intervals/scanning")(path)
    of_toast("detdata/flags", to=lambda v: 0 * v + 8)(path)  # a bit that TOAST's map-makers keep
    of_toast("shared/flags", to=lambda v: put(slice(3, 5), 1)(0 * v + 32))(path)
    attribute("observation_detector_flags", '{"d1": 1, "d2": 8}')(path)
    of_table(lambda table: table[::-1])(path)
    found = mm.read_timestreams(path)
    np.testing.assert_allclose(found.data_mk, MADE.data_mk.astype(float) * 1e-6, rtol=1e-14)
    assert (found.scan == 0).all()
    expected = np.zeros((N_DET, N_SAMP), bool)
    expected[:, 3:5] = expected[1] = True
    np.testing.assert_array_equal(found.flags, expected)
    assert apart(sights(found), sights(MADE)) < 1e-4 * ARCSEC


def table_with(change):
    """Change columns (a dictionary of arrays and units) and keywords of a FITS table."""

    def changed(path):
        with fits.open(path, memmap=False) as file:
            columns = {column.name: [np.array(file[1].data[column.name]), column.unit] for column in file[1].columns}
            header = {key: file[1].header[key] for key in ("BMAJ", "BUNIT")}
        change(columns, header)
        kinds = {"f": "D", "i": "K", "S": "8A", "U": "8A"}
        made = [fits.Column(k, kinds[v.dtype.kind], unit=unit, array=v) for k, (v, unit) in columns.items()]
        table = fits.BinTableHDU.from_columns(made)
        table.header.update(header)
        fits.HDUList([fits.PrimaryHDU(), table]).writeto(path, overwrite=True)

    return changed


def column(name, change, unit=None):
    def changed(columns, header):
        columns[name] = [change(columns[name][0]), unit or columns[name][1]]

    return table_with(changed)


def cut(columns, header):
    for values in columns.values():
        values[0] = values[0][1:]


WRONG_FITS = {
    "no table": (lambda path: fits.PrimaryHDU().writeto(path, overwrite=True), "has no table with the column PIXID"),
    "no signal": (table_with(lambda c, h: c.pop("FNU")), "lacks the column FNU"),
    "two columns less": (table_with(lambda c, h: (c.pop("FNU"), c.pop("DX"))), "lacks the column DX, FNU"),
    "a row less": (table_with(cut), "PIXID 1 has 600 rows, 0 has 599; one number"),
    "flux": (column("FNU", lambda v: v, "Jy/beam"), "the unit of FNU: found 'Jy/beam'; K, mK or uK is expected"),
    "positions in metres": (column("DX", lambda v: v, "m"), "the unit of DX: found 'm'; rad is expected"),
    "NaN in positions": (column("DY", put(5, np.nan)), "DY: found nan"),
    "positions in degrees": (column("DY", lambda v: v * 57.3), "DY: found 51.9759 rad; declinations are expected"),
    "loose detectors": (column("DX", lambda v: v + 1e-3 * np.sin(np.arange(len(v)))), "detectors move in the array by"),
    "detectors apart": (column("DY", put(slice(0, 600), -1.0)), "a quarter of a turn apart; an array is expected"),
    "own times": (column("TIME", put(700, 0.0)), "TIME of PIXID 1 differs from that of 0"),
    "own scans": (column("SCAN", put(700, 5)), "SCAN differs between the detectors"),
    "text": (column("FNU", lambda v: v.astype("S8")), "FNU: found the type"),
    "no beam": (table_with(lambda c, h: h.pop("BMAJ")), "lacks the keyword BMAJ; give the beam"),
    "a beam in arcsec": (
        table_with(lambda c, h: h.update(BMAJ=9.0)),
        r"BMAJ \[deg\]: found 9.0; a finite number above 0",
    ),
}


@pytest.mark.parametrize("case", WRONG_FITS)
def test_wrong_fits_tables(file_of, case):
    change, words = WRONG_FITS[case]
    path = file_of("mustang2")
    change(path)
    refused(mm.read_timestreams, path, words)


def test_other_fits_tables(file_of):
    """No scans, no units, samples by time, right ascensions below 0, single precision: within 0.1 arcsec."""

    def change(columns, header):
        del columns["SCAN"], header["BUNIT"]
        order = np.arange(N_DET * N_SAMP).reshape(N_DET, N_SAMP).T.ravel()
        for item in columns.values():
            item[:] = item[0][order], None
        columns["DX"][0] = np.where(columns["DX"][0] > np.pi, columns["DX"][0] - 2 * np.pi, columns["DX"][0])
        columns["DY"][0] = columns["DY"][0].astype("f4").astype(float)

    path = file_of("mustang2")
    table_with(change)(path)
    found = mm.read_timestreams(path)
    assert (found.scan == 0).all() and found.data_mk.shape == MADE.data_mk.shape
    np.testing.assert_allclose(found.data_mk, MADE.data_mk, rtol=1e-15)
    np.testing.assert_array_equal(found.flags, MADE.flags)
    assert apart(sights(found), sights(MADE)) < 0.1 * ARCSEC


@pytest.mark.parametrize("format", ["toast", "mustang2"])
@pytest.mark.parametrize("seed", range(2))
def test_mangled_files(whole, tmp_path, format, seed):
    """Some bytes are others, or the file ends early: an error of one line, or what it held."""
    rng, path = np.random.default_rng(seed), tmp_path / "mangled"
    for _ in range(8):
        mangled = bytearray(whole[format])
        for place in rng.integers(0, 6000, 12):
            mangled[place] = rng.integers(0, 256)
        path.write_bytes(mangled[: rng.integers(len(mangled) // 4, len(mangled))] if rng.random() < 0.3 else mangled)
        try:
            assert np.isfinite(mm.read_timestreams(path).ra_rad).all()
        except ValueError as error:
            assert str(error).startswith(f"{path}: ") and "\n" not in str(error) and len(str(error)) < 500


def test_every_format_has_a_test():
    assert FORMATS.keys() == {*SUFFIXES, "g3"}  # that of g3 needs its library
    assert not toast.losses(MADE)
