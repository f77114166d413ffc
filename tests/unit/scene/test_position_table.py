"""Tables of positions: what is read, and that every other table is refused in one line with its row or column."""

import math
import os

import numpy as np
import pytest

from surveysim.reduction.setup import prepare
from surveysim.runtime.errors import SceneError
from surveysim.scene.position_table import MAX_BYTES, read_positions
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
        read_positions(path)
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
    np.testing.assert_allclose(read_positions(path), expected, rtol=1e-14)


def test_a_written_quantity_table_is_read(tmp_path):
    import astropy.units as u
    from astropy.table import QTable

    QTable({"x": [0, 4] * u.arcsec, "y": [0.5, 0] * u.deg}).write(tmp_path / "camera.ecsv")
    np.testing.assert_allclose(np.degrees(read_positions(tmp_path / "camera.ecsv")), [[0, 0.5], [4 / 3600, 0]])


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
        ("40.0 0.5", "0.0 0.0", "row 2: found the position of row 1; different positions are expected"),
        ("-20.0 -1.5", "40.0 0.5", "row 3: found the position of row 2"),
        ("\n0.0 0.0\n40.0 0.5\n-20.0 -1.5\n", "\n", "found no row; one row for each detector is expected"),
        # columns
        ("x y\n", "x z\n", "column 'z': unknown; only the columns x and y are allowed"),
        ("x y\n", "x x\n", "column 'x': found more than once; the columns x and y, each once, are expected"),
        ("x y\n", "X y\n", "column 'X': unknown"),
        ("\nx y\n0.0 0.0\n40.0 0.5\n-20.0 -1.5\n", "\nx\n0.0\n", "column 'y': missing; the columns x and y"),
        ("unit: arcsec, ", "", "column 'x': found no unit; an angular one like arcsec is expected in the header"),
        ("unit: arcsec", "unit: mm", "column 'x': found the unit 'mm'; one of angle like arcsec is expected"),
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


def test_dead_detectors_are_no_column(tmp_path):
    """A column that is not known is refused: one of dead detectors was passed over, and they were simulated."""
    (path := tmp_path / "camera.ecsv").write_text(DEAD)
    assert refusal(path) == (
        "column 'dead': unknown; only the columns x and y are allowed; leave out rows of detectors that do not work"
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "found an empty file; '# %ECSV 1.0' is expected"),
        (b"x,y\n1,2\n", "found 'x,y'; '# %ECSV 1.0' is expected"),
        (TABLE.replace("40.0", "40.0°").encode("latin-1"), "line 9 is not UTF-8: found the byte 0xb0"),
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "line 1 is not UTF-8"),
        (HEAD.encode(), "found no row of column names"),
        (TABLE.encode() + b"0 1\n" * (MAX_BYTES // 4), "found more than 10 MB; an ECSV table is expected"),
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
        ("", "can't be read (Is a directory); an ECSV table is expected"),
        ("pipe", "found a pipe or a device, not a file; an ECSV table"),
        ("loop", "can't be read (Too many levels of symbolic links)"),
        ("nowhere.ecsv", "no such file in the folder of the scene; an ECSV table is expected"),
    ):
        assert refusal(tmp_path / name).startswith(words)
    assert "a pipe or a device" in str(pytest.raises(ValueError, read_positions, "/dev/zero").value)


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
