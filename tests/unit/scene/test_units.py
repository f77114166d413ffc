import math

import astropy.units as u
import pytest

from surveysim.scene.passband import top_hat
from surveysim.scene.units import _COMMON, to_float, to_floats, to_sky_angle

ROUNDING = 1e-14


@pytest.mark.parametrize(
    "text, unit, expected",
    [
        ("4 arcmin / s", "rad / s", 4 * math.pi / 10800),
        ("143 GHz", "Hz", 143e9),
        ("2.5 mK2 / Hz", "mK2 / Hz", 2.5),
        ("100 uK2", "mK2", 1e-4),
        ("-3 km", "m", -3000.0),
        ("3 hourangle", "rad", math.pi / 4),
        ("46 mK2 rad(-5/3)", "mK2 rad(-5/3)", 46.0),
        ("46 mK2 deg(-5/3)", "mK2 rad(-5/3)", 46 * (180 / math.pi) ** (5 / 3)),
        (7, "", 7.0),
        ("7", "", 7.0),
    ],
)
def test_quantities_in_internal_units(text, unit, expected):
    assert to_float(text, unit) == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.parametrize(
    "found", [4, 4.0, "4", "4 arcmin", "4 parsnips / s", "fast", "", "1, 2 rad / s", "[1, 2] rad / s"]
)
def test_anything_but_a_quantity_of_the_unit_is_refused(found):
    with pytest.raises(ValueError, match="expected") as caught:
        to_float(found, "rad / s")
    assert str(found) in str(caught.value) and "rad / s" in str(caught.value)


@pytest.mark.parametrize("found", [True, None, [1], {"value": 1}, b"1 s"])
def test_other_types_are_refused(found):
    with pytest.raises(ValueError, match="expected") as caught:
        to_float(found, "s")
    assert repr(found) in str(caught.value)


@pytest.mark.parametrize("found", ["nan s", "inf s", "-inf s", "1e400 s", "infinity s"])
def test_quantities_are_finite(found):
    with pytest.raises(ValueError, match="a finite number is expected") as caught:
        to_float(found, "s")
    assert found in str(caught.value)


@pytest.mark.parametrize("found", [math.nan, math.inf])
def test_plain_numbers_are_finite(found):
    with pytest.raises(ValueError, match="a finite number is expected"):
        to_float(found, "")


@pytest.mark.parametrize("found", ["finite", "infinite", "non-finite s"])
def test_words_that_only_mention_finite_are_refused_like_others(found):
    with pytest.raises(ValueError, match="expected"):
        to_float(found, "s")


@pytest.mark.parametrize("found", ["[46, 100.5,1e3] mK2", ["46 mK2", "100.5 mK2", "1e9 uK2"], "  [46 ,100.5, 1000]mK2"])
def test_lists_of_quantities(found):
    assert to_floats(found, "mK2") == pytest.approx((46, 100.5, 1000), rel=ROUNDING)


@pytest.mark.parametrize(
    "found",
    ["[46, 100", "46 mK2", "[] mK2", "[1,,2] mK2", "[1, 2]", "[1, 2] s", "[1, nan] mK2", [1, 2], 46, None],
)
def test_broken_lists_are_refused(found):
    with pytest.raises(ValueError, match="found .* expected"):
        to_floats(found, "mK2")


@pytest.mark.parametrize(
    "text, degrees",
    [
        ("08h49m12s", 15 * (8 + 49 / 60 + 12 / 3600)),
        ("+44d50m24.6s", 44 + 50 / 60 + 24.6 / 3600),
        ("-00d30m00s", -0.5),
        ("-155.4761 deg", -155.4761),
        ("90 arcmin", 1.5),
    ],
)
def test_sky_angles(text, degrees):
    assert to_sky_angle(text) == pytest.approx(math.radians(degrees), rel=ROUNDING)


@pytest.mark.parametrize("found", ["08h60m00s", "08h00m60s", "08h49m", "12 h", 12.0, "north", None])
def test_broken_sky_angles_are_refused(found):
    with pytest.raises(ValueError, match="expected") as caught:
        to_sky_angle(found)
    assert str(found) in str(caught.value)


def test_rayleigh_jeans_to_cmb():
    # The limit of low frequency is 1 + x^2 / 12; 1.65 at 143 GHz (x = 2.518) worked out by hand.
    assert top_hat(143e9, 0.0).cmb_per_rj == pytest.approx(1.65, abs=0.005)
    x = 6.62607015e-34 * 1e9 / (1.380649e-23 * 2.7255)
    assert top_hat(1e9, 0.0).cmb_per_rj - 1 == pytest.approx(x**2 / 12, rel=1e-3)
    assert top_hat(1.0, 0.5).cmb_per_rj == pytest.approx(1, rel=1e-12)


def test_rayleigh_jeans_to_cmb_is_the_ratio_of_brightness_derivatives():
    from astropy import units as u

    for frequency in (90e9, 143e9, 275e9):
        jansky = (1 * u.K).to(u.Jy / u.sr, u.brightness_temperature(frequency * u.Hz))
        thermodynamic = jansky.to(u.K, u.thermodynamic_temperature(frequency * u.Hz, 2.7255 * u.K))
        assert top_hat(frequency, 0.0).cmb_per_rj == pytest.approx(thermodynamic.to_value(u.K), rel=1e-6)


@pytest.mark.parametrize(
    ("frequency_hz", "bandwidth", "too_high", "digit"),
    [(268e9, 0.15, 0.012, 1e-3), (350e9, 0.25, 0.08, 1e-2), (410e9, 0.40, 0.38, 1e-2), (10e12, 0.99, math.nan, 0)],
)
def test_rayleigh_jeans_to_cmb_over_a_band(frequency_hz, bandwidth, too_high, digit):
    """Power of a single mode per temperature, by quadrature: d(h nu / (exp(h nu / k T) - 1)) / dT over k a hertz.

    `too_high` is by how much the band's centre alone overstates an amplitude, which is the square of the conversion.
    """
    from astropy import constants
    from scipy.integrate import quad

    h, k, t = (float(item) for item in (constants.h.si.value, constants.k_B.si.value, 2.7255))
    low, high = frequency_hz * (1 - bandwidth / 2), frequency_hz * (1 + bandwidth / 2)

    def slope(nu):
        x = h * nu / (k * t)
        return h * nu * x / t / (4 * math.sinh(x / 2) ** 2) / k

    scale = slope(low)
    mean = quad(lambda nu: slope(nu) / scale, low, high, epsrel=1e-12, epsabs=0, limit=200)[0] / (high - low)
    found = top_hat(frequency_hz, bandwidth).cmb_per_rj
    assert found == pytest.approx(1 / (mean * scale), rel=1e-8)
    if digit:
        assert (top_hat(frequency_hz, 0.0).cmb_per_rj / found) ** 2 - 1 == pytest.approx(too_high, abs=digit / 2)


@pytest.mark.parametrize("unit", _COMMON)
def test_common_units_have_the_factors_of_astropy(unit):
    """To the last bit: astropy is asked for all other units."""
    assert _COMMON[unit] == {found: float(u.Unit(found).to(unit)) for found in _COMMON[unit]}
