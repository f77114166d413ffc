"""Reading tables of weather: forms of time, and one line for each fault."""

import numpy as np
import pytest

from surveysim.runtime.errors import InputError
from surveysim.scene.weather_table import date_text, weather_table

POWER = "rad(-5/3)"
HEAD = "# %ECSV 1.0\n# ---\n# datatype:\n"


def write(tmp_path, header, rows):
    lines = "".join(f"# - {{{column}, datatype: {kind}}}\n" for column, kind in header)
    names = " ".join(column.split(",")[0].removeprefix("name: ") for column, _ in header)
    path = tmp_path / "w.ecsv"
    path.write_text(HEAD + lines + "\n".join([names, *rows]) + "\n")
    return path


TIME, TEXT = ("name: time", "float64"), ("name: time", "string")
WATER, SPEED = ("name: pwv, unit: mm", "float64"), ("name: wind_speed, unit: m / s", "float64")
FROM = ("name: wind_direction, unit: deg", "float64")


def test_times_are_mjd_or_iso_8601(tmp_path):
    expected = np.array([53000.25, 53000.5])
    texts = ["2003-12-27T06:00 1", "2003-12-27T12:00:00.000Z 2"]
    for header, rows in (([TIME, WATER], ["53000.25 1", "53000.5 2"]), ([TEXT, WATER], texts)):
        path = write(tmp_path, header, rows)
        weather_table.cache_clear()
        table = weather_table(path, POWER)
        np.testing.assert_array_equal(table.mjd, expected)
        np.testing.assert_array_equal(table.columns["pwv"], [1, 2])
    assert date_text(53000.25) == "2003-12-27T06:00"


def test_speeds_are_lengths_or_angles_over_time(tmp_path):
    table = weather_table(write(tmp_path, [TIME, SPEED, FROM], ["53000 10 -10", "53001 0 350"]), POWER)
    np.testing.assert_allclose(table.angular_speed(500.0), [0.02, 0])
    np.testing.assert_allclose(table.columns["wind_direction"], np.radians([-10, 350]))


@pytest.mark.parametrize(
    ("header", "rows", "words"),
    [
        ([TIME], ["53000"], "found the columns 'time'"),
        ([TIME, ("name: rain, unit: mm", "float64")], ["53000 1"], "found the columns 'time, rain'"),
        ([TIME, WATER], ["53000 1"], "found 1 rows, and two or more are needed"),
        (
            [TIME, WATER],
            ["53000 1", "53000 2"],
            "row 2, column 'time': found 53000, and more than in the row before",
        ),
        (
            [TIME, WATER],
            ["2004.1 1", "2004.2 2"],
            "row 1, column 'time': found 2004.1, and MJD 10000 to 1000000 is allowed",
        ),
        ([TEXT, WATER], ["noon 1", "later 2"], "row 1, column 'time': found 'noon', and an MJD or a time like"),
        ([TIME, WATER], ["53000 1", "53001 0"], "row 2, column 'pwv': found 0, and 0.001 to 100 is allowed"),
        ([TIME, WATER], ['53000 ""', "53001 1"], "row 1, column 'pwv': found nan, and 0.001 to 100 is allowed"),
        (
            [TIME, ("name: pwv", "float64")],
            ["53000 1", "53001 1"],
            "column 'pwv': found no unit, and one like mm",
        ),
        ([TIME, ("name: b2, unit: mK", "float64")], ["53000 1", "53001 1"], "column 'b2': found the unit 'mK'"),
        ([TIME, SPEED], ["53000 1", "53001 -1"], "row 2, column 'wind_speed': found -1, and 0 to 1000 is allowed"),
    ],
)
def test_a_fault_is_one_line(tmp_path, header, rows, words):
    path = write(tmp_path, header, rows)
    with pytest.raises(InputError) as error:
        weather_table(path, POWER)
    text = str(error.value)
    assert text.startswith(f"atmosphere.weather_table: {path}: {words}") and "\n" not in text
    assert text.endswith("pwv, b2, water_fluctuation, wind_speed, wind_direction is expected")


def test_b2_and_fluctuation_exclude_each_other(tmp_path):
    both = [("name: b2, unit: mK2 rad(-5/3)", "float64"), ("name: water_fluctuation, unit: rad(-5/3)", "float64")]
    with pytest.raises(InputError, match="column 'water_fluctuation': found together with 'b2', which follows from it"):
        weather_table(write(tmp_path, [TIME, *both], ["53000 1 1e-5", "53001 1 1e-5"]), POWER)
