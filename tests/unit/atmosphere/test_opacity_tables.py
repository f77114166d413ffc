"""Opacity by height, temperature, water and frequency, against `am`, and tables of the user."""

import math
from pathlib import Path

import numpy as np
import pytest
from astropy import units as u
from astropy.table import QTable, Table

from surveysim.atmosphere.opacity import band_opacity, optical_depth
from surveysim.atmosphere.opacity_tables import EDGES_GHZ, HEIGHTS_M, OFFSETS_K, PWV_MM, opacity_table
from surveysim.atmosphere.standard_air import air_pressure_mbar, air_temperature_k, vapour_temperature_k
from surveysim.runtime.errors import InputError, OutOfRangeError
from surveysim.scene.passband import top_hat
from surveysim.scene.place import Place, shipped_place
from tests.data.build_opacity_points import POINTS, direct_optical_depth, random_places

HEAD = "# - {name: frequency, unit: GHz}\n# - {atmosphere_temperature: 250}\nfrequency pwv_1 pwv_2 pwv_3 pwv_4\n"


def place(height_m, temperature_k, opacity=None):
    return Place("own", -0.4, 0.0, height_m, temperature_k, opacity)


def tabulated(height_m, temperature_k, pwv_mm, frequency_ghz):
    """Optical depth of one cell of the table."""
    band = band_opacity(place(height_m, temperature_k), top_hat(frequency_ghz * 1e9, 1 / frequency_ghz))
    return float(optical_depth(band, pwv_mm))


@pytest.fixture(scope="module")
def points():
    return Table.read(POINTS, format="ascii.ecsv")


def test_points_are_random_ones(points):
    drawn = random_places(len(points))
    assert len(points) == 200 and [tuple(row)[:4] for row in points] == drawn


def test_table_against_am_at_random_places(points):
    """Optical depth to a median and a worst of all points that are not opaque; transmission at all of them."""
    found = np.array([tabulated(*row[:4]) for row in map(tuple, points)])
    expected = np.array(points["optical_depth"])
    assert np.abs(np.exp(-found) - np.exp(-expected)).max() < 0.003
    relative = np.abs(found / expected - 1)[expected < 10]
    assert np.median(relative) < 0.001 and relative.max() < 0.008


@pytest.mark.slow
def test_points_are_what_am_computes(points):
    pytest.importorskip("am")
    for row in list(map(tuple, points))[::40]:
        assert direct_optical_depth(*row[:4]) == pytest.approx(row[4], rel=1e-5)


def test_knots_of_the_table_are_its_own():
    """At a height and a temperature of the table nothing is interpolated."""
    path = Path(POINTS).parents[2] / "surveysim/atmosphere/tables/opacity_heights.npy"
    stored = np.load(path, mmap_mode="r")
    assert stored.shape == (len(HEIGHTS_M), len(OFFSETS_K), len(EDGES_GHZ) - 1, len(PWV_MM))
    assert path.stat().st_size < 3e6
    for i, j in ((0, 0), (3, 2), (6, 3)):
        temperature_k = float(air_temperature_k(HEIGHTS_M[i], OFFSETS_K[j]))
        found = opacity_table(place(float(HEIGHTS_M[i]), temperature_k)).optical_depth
        np.testing.assert_allclose(found, stored[i, j], rtol=1e-6)


@pytest.mark.parametrize("frequency_ghz", [30, 95, 150, 280, 350, 850])
def test_opacity_falls_with_height_and_rises_with_water(frequency_ghz):
    band = top_hat(frequency_ghz * 1e9, 0.1)
    heights = np.arange(0, 6001, 250.0)
    depth = [band_opacity(place(h, float(air_temperature_k(h, -10.0))), band) for h in heights]
    assert (np.diff([optical_depth(item, 1.0) for item in depth]) < 0).all()
    pwv_mm = np.geomspace(0.03, 60, 500)
    assert all((np.diff(optical_depth(item, pwv_mm)) > 0).all() for item in depth[::6])


def test_air_is_hydrostatic():
    """The gas law and weight: dp / dz = - p g / (R T), by differences."""
    height_m = np.arange(0.0, 40_001, 100)
    pressure = air_pressure_mbar(height_m, -25.0)
    slope = -np.diff(np.log(pressure)) / 100
    expected = 9.80665 / 287.05 / air_temperature_k(height_m[:-1] + 50, -25.0)
    np.testing.assert_allclose(slope, expected, rtol=2e-4)


@pytest.mark.parametrize(
    "height_m, offset_k, mbar", [(5060, 0.0, 555), (4070, -5.0, 620), (2835, -50.0, 680), (5600, 0.0, 515)]
)
def test_pressure_of_four_sites(height_m, offset_k, mbar):
    """Of the sites' own tables, by radiosondes and site testing: within 1.5 %."""
    assert air_pressure_mbar(float(height_m), offset_k) == pytest.approx(mbar, rel=0.015)


def test_vapour_is_as_warm_as_the_air_a_scale_height_up():
    """T falls by a constant lapse within the vapour: its mean temperature is that 2 km above the ground."""
    lapse = (283.7 - 197.0) / 13
    assert vapour_temperature_k(4000.0, 0.0) == pytest.approx(air_temperature_k(4000.0, 0.0) - 2 * lapse, abs=0.5)


# ------------------------------------------------------------ tables of the user


def write(path, pwv_mm=(0.5, 1, 2, 4), frequency=(90, 150, 220, 300), meta=True, scale=1.0, **options):
    table = QTable({"frequency": np.array(frequency) * u.GHz})
    for pwv in pwv_mm:
        table[f"pwv_{pwv:g}"] = scale * (0.02 + 0.01 * pwv * np.arange(1, len(frequency) + 1))
    table.meta = {"atmosphere_temperature": 255.5} if meta else {}
    table.write(path, format="ascii.ecsv", **options)
    return path


@pytest.mark.parametrize("delimiter", [" ", ","])
def test_a_table_of_the_user(tmp_path, delimiter):
    path = write(tmp_path / "own.ecsv", delimiter=delimiter)
    band = band_opacity(place(9000, 100, path), top_hat(150e9, 0.01))
    assert optical_depth(band, 1.0) == pytest.approx(0.04) and band.temperature_k == 255.5
    both = band_opacity(place(0, 0, path), top_hat(185e9, 0.02))  # half in the cell of 150 GHz, half in 220's
    assert optical_depth(both, 1.0) == pytest.approx(-math.log((math.exp(-0.04) + math.exp(-0.05)) / 2))


def test_a_band_outside_a_table_of_the_user(tmp_path):
    path = write(tmp_path / "own.ecsv")
    with pytest.raises(OutOfRangeError, match="found a band of 360 to 440 GHz; bands within 60 to 340 GHz are allowed"):
        band_opacity(place(5000, 268, path), top_hat(400e9, 0.2))


def test_a_table_that_ships_is_one_of_a_user(tmp_path):
    own = shipped_place("alma")
    copy = tmp_path / "copy.ecsv"
    copy.write_bytes(own.opacity.read_bytes())
    band = top_hat(280e9, 0.1)
    np.testing.assert_array_equal(
        band_opacity(own, band).optical_depth, band_opacity(place(0, 0, copy), band).optical_depth
    )


@pytest.mark.parametrize(
    "options, words",
    [
        ({"meta": False}, "found no 'atmosphere_temperature'"),
        ({"pwv_mm": (1, 2, 3)}, "four or more increasing waters are needed"),
        ({"pwv_mm": (1, 2, 4, 3)}, "four or more increasing waters are needed"),
        ({"frequency": (90, 150, 140, 200)}, "row 3: found 140, and frequencies that increase are expected"),
        ({"frequency": (90,)}, "found 1 rows, and two or more are needed"),
        ({"scale": -1.0}, "row 1: found -0.06, and optical depths of 0 or more are expected"),
    ],
)
def test_tables_refused(tmp_path, options, words):
    path = write(tmp_path / "own.ecsv", **options)
    with pytest.raises(InputError) as caught:
        opacity_table(place(0, 280, path))
    assert words in str(caught.value) and str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text, words",
    [
        ("", "found the columns ''"),
        ("frequency pwv_1 pwv_2 pwv_3 pwv_4\n1 2 3 4 5\n", "column 'frequency': found no unit GHz"),
        ("nu tau\n", "found the columns 'nu, tau'"),
        ("frequency pwv_1 pwv_2 pwv_3 depth\n", "found the columns"),
        (
            HEAD + "1 2 3 4\n",
            "row 1: found '1 2 3 4', and 5 finite",
        ),
        (
            HEAD + "1 2 3 4 nan\n",
            "row 1: found '1 2 3 4 nan', and 5 finite",
        ),
    ],
)
def test_texts_refused(tmp_path, text, words):
    path = tmp_path / "own.ecsv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        opacity_table(place(0, 280, path))
    assert words in str(caught.value) and "\n" not in str(caught.value)


def test_places_outside_the_table():
    with pytest.raises(OutOfRangeError, match="found a height of 6500 m; 0 to 6000 m is allowed"):
        opacity_table(place(6500, 250))
    with pytest.raises(OutOfRangeError, match="found 330 K at a height of 0 m; 239.7 to 314.7 K is allowed there"):
        opacity_table(place(0, 330))
