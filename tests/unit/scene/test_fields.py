"""One number and one unit: every reading of a quantity, a number or a date that would surprise is refused."""

import math

import pytest

from surveysim.scene.units import to_float, to_floats, to_sky_angle

# Of these astropy alone reads the first as 16 s, the second as 4 s^2, the third as 4 electron charges, and so on.
WRONG = [
    "4 4 s", "4 s s", "4e", "4e s", "1 2", "4 4", "4 s 4", "4 s 1", "4 1 s", "0x10 s", "0b1 s", "1_000 s", "4,5 s",
    "4.5.6 s", "--4 s", "+-4 s", "4e1.5 s", "4e+ s", "(4) s", "4 * s", "4*4 s", "2 * 2 s", "4 / 1 s", "4 s / 1",
    "4 m/s/s", "4 s/m/Hz", "4 10 s", "4 10s", "4 10**3 s", "1 2 3 deg", "4 mag", "4 mag(s)", "4 dex(s)", "4 sqrt(s2)",
    "4 's'", '4 "s"', "4 arcmin'", "٤ s", "４ s", "²4 s", "4 ｓ", "4 ѕ", "4 s;", "4 s # s", "s", "s 4", "", " ", "s4",
    "4 s + 4 s", "4 s - 1 s", "4 s, 5 s", "[4] s", "4 parsnips", "4 S", "4 arcmin", "4 m s / m / s", "True s", "4 s\0",
    "4 " + "s " * 500, "9" * 5000 + " s",
]  # fmt: skip
RIGHT = {
    "4 s": 4, "4s": 4, " 4  s ": 4, "+4 s": 4, "4. s": 4, ".5 s": 0.5, "4e0s": 4, "4E-1 s": 0.4, "1 min": 60,
    "4 s^1": 4, "4 s**1": 4, "4 / Hz": 4, "4 s2 / s": 4, "4 s2 s-1": 4, "4 s(1)": 4, "4 s . s / s": 4, "1 ks": 1000,
    "1 \u00b5s": 1e-6, "1 day": 86400,
}  # fmt: skip


@pytest.mark.parametrize("found", WRONG)
def test_texts_that_are_no_quantity_are_refused(found):
    with pytest.raises(ValueError, match="found .*expected") as caught:
        to_float(found, "s")
    assert len(str(caught.value)) < 200 and "\n" not in str(caught.value)


@pytest.mark.parametrize("found", RIGHT)
def test_texts_that_are_quantities(found):
    assert to_float(found, "s") == pytest.approx(RIGHT[found], rel=1e-14)


@pytest.mark.parametrize(
    "text", ["nan s", "inf s", "-inf s", "+infinity s", "NaN s", "1e309 s", "-1e400 s", "nan", "inf"]
)
def test_no_number_is_infinite(text):
    with pytest.raises(ValueError, match="a finite number is expected"):
        to_float(text, "s")


def test_whole_numbers_beyond_floats_are_refused():
    with pytest.raises(ValueError, match="a finite number is expected"):
        to_float(10**400, "")


@pytest.mark.parametrize("found", ["[1, 2 3] s", "[1 s, 2 s] s", "[1, 2] s s", "[[1], 2] s", "[1, ٢] s", "[1, 2_0] s"])
def test_lists_have_one_number_a_place(found):
    with pytest.raises(ValueError, match="found .*expected"):
        to_floats(found, "s")


@pytest.mark.parametrize(
    "found",
    [
        "08h49m12s 4",
        "4 4",
        "08h49m1e1s",
        "0٨h49m12s",
        "08 49 12",
        "8:49:12",
        "08h49m12s12",
        "+-1d0m0s",
        "1h 2h",
        "999999999h0m0s",
    ],
)
def test_directions_have_one_reading(found):
    with pytest.raises(ValueError, match="found .*expected"):
        to_sky_angle(found)


def test_units_of_any_power():
    assert to_float("4 mK2 rad(-1333/1000)", "mK2 rad(-1333/1000)") == 4
    assert to_float("4 mK^2 / Hz", "mK2 / Hz") == to_float("4 mK**2 Hz^-1", "mK2 / Hz") == 4
    assert to_float("4 W / Hz(0.5)", "W / Hz(1/2)") == 4
    assert to_float("1 deg", "rad") == math.pi / 180
