"""Passbands: integrals against closed forms and quadrature, and tables that are refused in one line."""

import math
from pathlib import Path

import numpy as np
import pytest

from surveysim.output.scene_copy import SCENE_FILE, scene_files
from surveysim.runtime.errors import InputError, SceneError
from surveysim.scene.passband import Passband, named_passbands, read_passband, top_hat
from surveysim.scene.scene import load_scene, scene_hash
from tests.scenes import SMALL_SCENE

HEADER = (
    "# %ECSV 1.0\n# ---\n# datatype:\n# - {name: frequency, unit: GHz, datatype: float64}\n"
    "# - {name: transmission, datatype: float64}\nfrequency transmission\n"
)
TRIANGLE = Passband((100e9, 150e9, 160e9), (0.0, 0.8, 0.0))


def write(folder: Path, rows: str, header: str = HEADER) -> Path:
    path = folder / "band.ecsv"
    path.write_text(header + rows)
    return path


def test_a_top_hat():
    band = top_hat(143e9, 0.15)
    assert band.centre_hz == pytest.approx(143e9, rel=1e-14) and band.width_hz == pytest.approx(0.15 * 143e9)
    assert band.edges_hz == pytest.approx((143e9 * 0.925, 143e9 * 1.075))
    shares = band.cell_shares(np.array([130e9, 140e9, 143e9, 150e9, 160e9]))
    inside = np.array([140e9 - 143e9 * 0.925, 3e9, 7e9, 143e9 * 1.075 - 150e9]) / (0.15 * 143e9)
    np.testing.assert_allclose(shares, inside, rtol=1e-12)


def test_a_band_without_width_is_its_centre():
    band = top_hat(143e9, 0.0)
    assert band.centre_hz == 143e9 and band.width_hz == 0
    assert band.cell_shares(np.array([142e9, 143e9, 144e9])).tolist() == [0, 1]


def test_a_triangle_by_hand():
    """The centre of mass of a triangle is the mean of its corners."""
    assert TRIANGLE.centre_hz == pytest.approx((100e9 + 150e9 + 160e9) / 3, rel=1e-12)
    assert TRIANGLE.width_hz == pytest.approx(30e9)
    shares = TRIANGLE.cell_shares(np.array([100e9, 125e9, 150e9, 155e9, 160e9]))
    area = 0.5 * 60 * 0.8
    expected = [0.5 * 25 * 0.4 / area, 25 * 0.6 / area, 5 * 0.6 / area, 0.5 * 5 * 0.4 / area]
    np.testing.assert_allclose(shares, expected, rtol=1e-12)


def test_averages_are_those_of_a_quadrature():
    from scipy.integrate import quad

    rng = np.random.default_rng(3)
    knots = np.sort(rng.uniform(90e9, 110e9, 40))
    value = rng.uniform(0, 1, 40)
    band = Passband(tuple(knots), tuple(value))
    frequency, weight = band.nodes
    assert weight.sum() == pytest.approx(1, rel=1e-13)

    def area(low, high, of=lambda nu: 1.0):
        inside = [nu for nu in knots if low < nu < high]
        bounds = [low, *inside, high]
        parts = (
            quad(lambda nu: np.interp(nu, knots, value, 0, 0) * of(nu), a, b, epsabs=0, epsrel=1e-11)[0]
            for a, b in zip(bounds, bounds[1:], strict=False)
            if band.edges_hz[0] <= a < band.edges_hz[1]
        )
        return sum(parts)

    def shape(nu):
        return math.exp(-nu / 50e9)

    whole = area(*band.edges_hz)
    assert weight @ np.exp(-frequency / 50e9) == pytest.approx(area(*band.edges_hz, shape) / whole, rel=1e-9)
    edges = np.linspace(95e9, 105e9, 9)
    expected = [area(a, b) / whole for a, b in zip(edges, edges[1:], strict=False)]
    np.testing.assert_allclose(band.cell_shares(edges), expected, rtol=1e-8)


def test_a_table_of_a_top_hat_is_one(tmp_path):
    band = read_passband(write(tmp_path, "130 0.5\n140 0.5\n155 0.5\n"))
    one = top_hat(142.5e9, 25 / 142.5)
    assert (band.centre_hz, band.width_hz) == pytest.approx((one.centre_hz, one.width_hz))
    assert band.cmb_per_rj == pytest.approx(one.cmb_per_rj, rel=1e-10)


def test_named_bands():
    assert read_passband("alma_band_6").edges_hz == (211e9, 275e9)
    assert all(read_passband(name).width_hz > 0 for name in named_passbands())
    with pytest.raises(InputError, match="found 'alma_band_66'.*alma_band_6.*is expected"):
        read_passband("alma_band_66")


@pytest.mark.parametrize(
    ("rows", "header", "expected"),
    [
        ("100 1\n", HEADER, "found 1 rows"),
        ("100 1\n90 1\n", HEADER, "row 2, column 'frequency': found 90 GHz"),
        ("100 1\n100 1\n", HEADER, "row 2, column 'frequency'"),
        ("100 1\n110 1.2\n", HEADER, "row 2, column 'transmission': found 1.2, and 0 to 1 is allowed"),
        ("100 nan\n110 1\n", HEADER, "row 1, column 'transmission': found nan"),
        ('100 1\n110 ""\n', HEADER, "row 2, column 'transmission': found nan"),
        ("100 0\n110 0\n", HEADER, "found 0 in all rows"),
        ("100 1\n110 1\n", HEADER.replace("unit: GHz, ", ""), "column 'frequency': found no unit"),
        ("100 1\n110 1\n", HEADER.replace("GHz", "arcsec"), "found the unit 'arcsec'"),
        ("100 1\n110 1\n", HEADER.replace("transmission", "gain"), "found the columns 'frequency, gain'"),
        ("100 1\n110 1\n", "frequency transmission\n", "instead of '# %ECSV 1.0'"),
        ("100 1 1\n110\n", HEADER, "not an ECSV table"),
    ],
)
def test_other_tables_are_refused_in_one_line(tmp_path, rows, header, expected):
    path = write(tmp_path, rows, header)
    with pytest.raises(InputError) as caught:
        read_passband(path)
    text = str(caught.value)
    assert text.startswith(f"instrument.passband: {path}: ") and expected in text and "\n" not in text


def scene_with(folder: Path, line: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(SMALL_SCENE.replace('frequency = "143 GHz"', line))
    return path


def test_a_scene_with_a_table(tmp_path):
    """The hash follows the content of the table, not its name."""
    table = write(tmp_path, "100 0\n150 0.8\n160 0\n")
    path = scene_with(tmp_path, 'passband = "band.ecsv"')
    first = load_scene(path)
    assert first.instrument.band == TRIANGLE and first.instrument.cmb_per_rj == TRIANGLE.cmb_per_rj
    before = scene_hash(first)
    table.rename(tmp_path / "other.ecsv")
    assert scene_hash(load_scene(scene_with(tmp_path, 'passband = "other.ecsv"'))) == before
    (tmp_path / "other.ecsv").write_text(HEADER + "100 0\n150 0.7\n160 0\n")
    assert scene_hash(load_scene(path)) != before


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ('passband = "no.ecsv"', "instrument.passband: .*no.ecsv: no such file in the folder of the scene"),
        ('passband = "alma_band_3"\nbandwidth = 0.1', "instrument.bandwidth: found together with 'passband'"),
        ('passband = "alma_band_3"\nfrequency = "1 mm"', "exactly one of 'frequency' and 'passband'|frequency"),
        ("", "exactly one of 'frequency' and 'passband'"),
    ],
)
def test_a_wrong_band_is_one_line(tmp_path, line, expected):
    with pytest.raises(SceneError, match=expected) as caught:
        load_scene(scene_with(tmp_path, line))
    assert "\n" not in str(caught.value)


def test_a_named_band_is_copied_as_a_name(tmp_path):
    scene = load_scene(scene_with(tmp_path, 'passband = "alma_band_3"'))
    files = scene_files(scene)
    assert files.keys() == {SCENE_FILE} and b'passband = "alma_band_3"\n' in files[SCENE_FILE]
