"""Tables of detectors: what is read, and that every other table is refused in one line with its row or column."""

import math
import os

import numpy as np
import pytest

from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.detector_table import MAX_BYTES, read_detectors
from surveysim.scene.scene import load_scene
from tests.scenes import SMALL_SCENE

HEAD = """\
# %ECSV 1.0
# ---
# datatype:
# - {name: x, unit: arcsec, datatype: float64}
# - {name: y, unit: arcmin, datatype: float64}
# schema: astropy-2.0
"""
TABLE = HEAD + "x y\n0.0 0.0\n40.0 0.5\n-20.0 -1.5\n"
CSV = TABLE.replace("# datatype", "# delimiter: ','\n# datatype").replace("x y", "x,y").replace("0 0", "0,0")
CSV = CSV.replace("40.0 0.5", "40.0,0.5").replace("-20.0 -1.5", "-20.0,-1.5")
DEAD = TABLE.replace("# schema", "# - {name: dead, datatype: bool}\n# schema").replace("x y", "x y dead")
DEAD = DEAD.replace("0.0 0.0\n", "0.0 0.0 False\n").replace("0.5\n", "0.5 True\n").replace("1.5\n", "1.5 False\n")


def refusal(path):
    """The one line that a table is refused with, less its file."""
    with pytest.raises(ValueError) as caught:
        read_detectors(path)
    begin, text = f"instrument.positions: {path}: ", str(caught.value)
    assert text.startswith(begin) and len(text.splitlines()) == 1
    return text.removeprefix(begin)


@pytest.mark.parametrize(
    "text",
    [
        TABLE,
        CSV,
        CSV.replace("','", '","'),
        CSV.replace("','", "','  # as of a spreadsheet"),
        "\ufeff" + TABLE,
        TABLE.replace("\n", "\r\n"),
        TABLE.replace("0.0 0.0", "0 0"),
        TABLE.replace("\n40", "\n\n40").replace("# ---\n", "# ---\n\n"),
        TABLE.replace("float64}\n", "float64}  # offsets\n").replace("\n40", "\n# good\n  # as well\n  40"),
    ],
    ids=["spaces", "commas", "quoted", "noted", "byte order mark", "crlf", "integers", "blank lines", "comments"],
)
def test_tables_that_are_read(tmp_path, text):
    (path := tmp_path / "camera.ecsv").write_bytes(text.encode())
    expected = np.array([[0, 0], [40, 30], [-20, -90]]) * math.radians(1 / 3600)
    np.testing.assert_allclose(read_detectors(path).positions_rad, expected, rtol=1e-14)


def test_a_written_quantity_table_is_read(tmp_path):
    import astropy.units as u
    from astropy.table import QTable

    QTable({"x": [0, 4] * u.arcsec, "y": [0.5, 0] * u.deg}).write(tmp_path / "camera.ecsv")
    np.testing.assert_allclose(
        np.degrees(read_detectors(tmp_path / "camera.ecsv").positions_rad), [[0, 0.5], [4 / 3600, 0]]
    )


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        # cells
        ("40.0 0.5", '"" 0.5', "row 2, column 'x': found an empty cell; a number is expected"),
        ("40.0 0.5", '40.0 ""', "row 2, column 'y': found an empty cell; a number is expected"),
        ("40.0 0.5", "40.0", "row 2: found 1 cells, '40.0'; 2 are expected"),
        ("40.0 0.5", "40.0 0.5 1", "row 2: found 3 cells, '40.0 0.5 1'; 2 are expected"),
        ("40.0 0.5", "nan 0.5", "row 2, column 'x': found 'nan arcsec'; a finite offset from the boresight of up"),
        ("-20.0 -1.5", "-20.0 -inf", "row 3, column 'y': found '-inf arcmin'; a finite offset"),
        ("-20.0 -1.5", "-20.0 901", "row 3, column 'y': found '901.0 arcmin'; a finite offset"),
        ("-20.0 -1.5", "1e300 0", "row 3, column 'x': found '1e+300 arcsec'"),
        ("40.0 0.5", "forty 0.5", "row 2, column 'x': found 'forty'; a number is expected"),
        ("40.0 0.5", "4_0 0.5", "row 2, column 'x': found '4_0'; a number is expected"),
        ("40.0 0.5", "٤ 0.5", "row 2, column 'x': found '٤'; a number is expected"),
        ("40.0 0.5", "40,0 0.5", "row 2, column 'x': found '40,0'; a number is expected"),
        ("40.0 0.5", "0.0 0.0", "row 2: found the position of row 1; different positions, bands or"),
        ("-20.0 -1.5", "40.0 0.5", "row 3: found the position of row 2"),
        ("\n0.0 0.0\n40.0 0.5\n-20.0 -1.5\n", "\n", "found no row; one row for each detector is expected"),
        # columns
        ("x y\n", "x z\n", "column 'z': unknown; the columns x, y, name, band, dead, nep,"),
        ("x y\n", "x x\n", "column 'x': found more than once; each column once is expected"),
        ("x y\n", "X y\n", "column 'X': unknown"),
        ("\nx y\n0.0 0.0\n40.0 0.5\n-20.0 -1.5\n", "\nx\n0.0\n", "column 'y': missing; the columns x and y"),
        ("unit: arcsec, ", "", "column 'x': found no unit; an angular one like arcsec is expected in the header"),
        ("unit: arcsec", "unit: mm", "column 'x': found the unit 'mm'; an angular one like arcsec is expected"),
        ("unit: arcmin", "unit: arcmin2", "column 'y': found the unit 'arcmin2'"),
        ("unit: arcsec", "unit: parsnip", "column 'x': found the unit 'parsnip'"),
        ("unit: arcsec", "unit: mag", "column 'x': found the unit 'mag'"),
        ("arcsec, datatype: float64", "arcsec, datatype: string", "column 'x': found datatype <U5; float64 is"),
        ("arcsec, datatype: float64", "arcsec, datatype: complex128", "column 'x': found datatype complex128"),
        # the file
        ("# %ECSV 1.0\n", "", "found '# ---'; '# %ECSV 1.0' is expected in the first line"),
        ("# datatype:", "# datatype: [", "not an ECSV table with columns x and y in angular units ("),
        ("# - {name: y, unit: arcmin, datatype: float64}\n", "", "not an ECSV table with columns x and y"),
    ],
)  # fmt: skip
def test_tables_that_are_refused(tmp_path, old, new, words):
    assert TABLE.count(old) == 1 or old.startswith("arcsec, ")
    (path := tmp_path / "camera.ecsv").write_text(TABLE.replace(old, new), encoding="utf-8")
    assert refusal(path).startswith(words)


def test_dead_detectors_are_flagged(tmp_path):
    (path := tmp_path / "camera.ecsv").write_text(DEAD)
    np.testing.assert_array_equal(read_detectors(path).live, [True, False, True])


COLUMNS = {
    "name": (["a", "b", "c"], None),
    "band": (["90", "90", "150"], None),
    "dead": ([False, False, True], None),
    "nep": ([30.0, 40.0, 50.0], "aW / Hz(1/2)"),
    "responsivity": ([1.0, 1.1, 0.9], None),
    "beam_fwhm": ([1.0, 1.2, 1.0], "arcmin"),
    "efficiency": ([100.0, 80.0, 120.0], "%"),
    "angle": ([0.0, 90.0, 45.0], "deg"),
    "time_constant": ([5.0, 6.0, 7.0], "ms"),
    "readout_group": ([1, 1, 2], None),
}
INTERNAL = {
    "nep": np.array([30, 40, 50]) * 1e-18,
    "responsivity": [1.0, 1.1, 0.9],
    "beam_fwhm": np.radians(np.array([1, 1.2, 1]) / 60),
    "efficiency": [1.0, 0.8, 1.2],
    "angle": np.radians([0, 90, 45]),
    "time_constant": [0.005, 0.006, 0.007],
}


def full_table(**changed):
    """A table of astropy with every column; changed ones as (values, unit), or None to leave one out."""
    from astropy.table import Column, Table

    found = {"x": ([0.0, 1.0, 2.0], "arcmin"), "y": ([0.0, 0.0, 0.0], "arcmin")} | COLUMNS | changed
    return Table({name: Column(item[0], unit=item[1]) for name, item in found.items() if item is not None})


@pytest.mark.parametrize("name", ["camera.ecsv", "camera.fits"])
def test_every_column_is_read_in_internal_units(tmp_path, name):
    full_table().write(tmp_path / name)
    table = read_detectors(tmp_path / name)
    for column, expected in INTERNAL.items():
        np.testing.assert_allclose(table.columns[column], expected, rtol=1e-13)
    assert table.columns["name"].tolist() == ["a", "b", "c"] and table.columns["band"].tolist() == ["90", "90", "150"]
    assert table.columns["readout_group"].tolist() == ["1", "1", "2"]
    np.testing.assert_array_equal(table.live, [True, True, False])


def test_a_psd_and_flags_of_one_and_zero(tmp_path):
    table = full_table(nep=None, psd=([1.0, 2.0, 3.0], "mK2 / Hz"), dead=([0, 1, 0], None))
    table.write(tmp_path / "camera.ecsv")
    found = read_detectors(tmp_path / "camera.ecsv")
    assert found.columns["psd"].tolist() == [1, 2, 3] and found.live.tolist() == [True, False, True]


def test_dead_detectors_need_no_properties(tmp_path):
    """Their cells can be empty or out of range; those of a live detector can't."""
    text = DEAD.replace("# schema", "# - {name: nep, unit: W / Hz(1/2), datatype: float64}\n# schema")
    text = text.replace("x y dead", "x y dead nep").replace(" False\n", " False 1e-17\n")
    for cell in ('""', "nan", "0.0"):
        (path := tmp_path / "camera.ecsv").write_text(text.replace(" True\n", f" True {cell}\n"))
        assert read_detectors(path).live.sum() == 2
        path.write_text(text.replace(" True\n", f" False {cell}\n"))
        assert refusal(path).startswith("row 2, column 'nep': found")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"nep": ([1e-17, 0.0, 1.0], "W / Hz(1/2)")},
            "row 2, column 'nep': found '0.0 W / Hz(1/2)'; an NEP from 1e-30",
        ),
        ({"nep": ([1.0, 1.0, 1.0], "W")}, "column 'nep': found the unit 'W'; one like W / Hz(1/2) is expected"),
        ({"nep": ([1.0, 1.0, 1.0], None)}, "column 'nep': found no unit; one like W / Hz(1/2) is expected"),
        ({"psd": ([1.0, 1.0, 1.0], "mK2 / Hz")}, "column 'psd': found together with 'nep'; one of the two"),
        ({"responsivity": ([1.0, -1.0, 1.0], None)}, "row 2, column 'responsivity': found '-1.0'; a responsivity from"),
        ({"efficiency": ([1.0, 1.0, 1.0], "m")}, "column 'efficiency': found the unit 'm'; no unit or a ratio like %"),
        ({"beam_fwhm": ([1.0, 40.0, 1.0], "deg")}, "row 2, column 'beam_fwhm': found '40.0 deg'; a beam from 0.001"),
        ({"angle": ([0.0, 361.0, 0.0], "deg")}, "row 2, column 'angle': found '361.0 deg'; a polarization angle"),
        ({"time_constant": ([0.0, -1.0, 0.0], "ms")}, "row 2, column 'time_constant': found '-1.0 ms'; a time"),
        ({"name": (["a", "a", "b"], None)}, "row 2, column 'name': found the name of row 1; another is expected"),
        ({"name": ([1.5, 2.5, 3.5], None)}, "column 'name': found datatype float64; string is expected"),
        ({"dead": ([0, 2, 0], None)}, "row 2, column 'dead': found '2'; True or False, or 1 or 0, is expected"),
        ({"dead": ([1.0, 0.0, 0.0], None)}, "row 1, column 'dead': found '1.0'; True or False"),
        ({"dead": ([True, True, True], None)}, "column 'dead': found all 3 detectors dead; a live one is expected"),
        ({"x": ([0.0, 0.0, 2.0], "arcmin"), "angle": ([45.0, 45.0, 0.0], "deg")}, "row 2: found the position of row 1"),
        ({"beam": ([1.0, 1.0, 1.0], None)}, "column 'beam': unknown; did you mean beam_fwhm?"),
    ],
)
def test_properties_that_are_refused(tmp_path, changed, words):
    full_table(**changed).write(tmp_path / "camera.ecsv")
    assert refusal(tmp_path / "camera.ecsv").startswith(words)


def test_fits_tables_are_checked_alike(tmp_path):
    full_table(nep=([1e-17, 0.0, 1.0], "W / Hz(1/2)")).write(path := tmp_path / "camera.fits")
    assert refusal(path).startswith("row 2, column 'nep': found '0.0 W")
    full_table(angle=([np.nan, 0.0, 0.0], "deg")).write(path, overwrite=True)
    assert refusal(path).startswith("row 1, column 'angle': found 'nan deg'")
    path.write_bytes(path.read_bytes()[:4000])
    assert refusal(path).startswith("not a FITS file with a table (")


def test_detectors_of_a_pixel_differ_in_band_or_angle(tmp_path):
    """Two bands, and two polarizations, can have one position."""
    apart = {"x": ([0.0, 0.0, 0.0], "arcmin"), "angle": ([0.0, 90.0, 0.0], "deg")}
    full_table(**apart).write(tmp_path / "camera.ecsv")
    assert len(read_detectors(tmp_path / "camera.ecsv")) == 3


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "found an empty file; '# %ECSV 1.0' is expected"),
        (b"x,y\n1,2\n", "found 'x,y'; '# %ECSV 1.0' is expected in the first line, or a FITS table"),
        (TABLE.replace("40.0", "40.0°").encode("latin-1"), "line 9 is not UTF-8: found the byte 0xb0"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "line 1 is not UTF-8"),
        (HEAD.encode(), "found no row of column names"),
        (TABLE.encode() + b"0 1\n" * (MAX_BYTES // 4), "found more than 10 MB; an ECSV or FITS table is expected"),
    ],
    ids=["empty", "csv", "latin-1", "hdf5", "header alone", "huge"],
)
def test_files_that_are_no_tables(tmp_path, content, words):
    (path := tmp_path / "camera.ecsv").write_bytes(content)
    assert refusal(path).startswith(words)


def test_files_that_are_no_files(tmp_path):
    """None of them is waited for."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    for name, words in (
        ("", "can't be read (Is a directory); an ECSV or FITS table is expected"),
        ("pipe", "found a pipe or a device, not a file; an ECSV or FITS table"),
        ("loop", "can't be read (Too many levels of symbolic links)"),
        ("nowhere.ecsv", "no such file in the folder of the scene; an ECSV or FITS table is expected"),
    ):
        assert refusal(tmp_path / name).startswith(words)
    assert "a pipe or a device" in str(pytest.raises(ValueError, read_detectors, "/dev/zero").value)


@pytest.mark.parametrize(
    "text",
    [TABLE[: TABLE.index("# schema")], TABLE[:-5], TABLE[: TABLE.index("0.0")], "\x00\x01\xff"],
    ids=["header only", "half a row", "no row", "binary"],
)
def test_broken_tables_are_refused(tmp_path, text):
    (path := tmp_path / "camera.ecsv").write_text(text, encoding="latin-1")
    assert refusal(path)


def test_a_link_to_itself_beside_a_scene(tmp_path):
    (tmp_path / "loop.ecsv").symlink_to("loop.ecsv")
    start, end = SMALL_SCENE.index("[instrument.layout]"), SMALL_SCENE.index("[scan]")
    scene = tmp_path / "small.toml"
    scene.write_text(f'{SMALL_SCENE[:start]}positions = "loop.ecsv"\n\n{SMALL_SCENE[end:]}')
    with pytest.raises(
        SceneError, match=r"positions: .*loop.ecsv: can't be read \(Too many levels of symbolic links\)"
    ):
        prepare(load_scene(scene))
