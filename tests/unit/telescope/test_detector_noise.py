"""Noise of bolometers and of KIDs against closed forms, quadrature and values by hand."""

import math

import pytest
from scipy.integrate import quad

from surveysim.scene.noise_and_sky import Bolometer, Detector
from surveysim.telescope.detector_noise import detector_nep2, phonon_nep2, recombination_nep2, saturation_power_w

K = 1.380649e-23


def bolometer(**changes):
    values = {
        "conductance": "100 pW / K",
        "critical_temperature": "165 mK",
        "bath_temperature": "100 mK",
        "exponent": 3,
        "amplifier_nep": "1e-17 W / Hz(1/2)",
    }
    return Bolometer.model_validate(values | changes)


def test_phonon_noise_by_hand():
    """4 k T^2 G F at b = 3, t = 0.60606: F = 4/9 (1 - t^9) / (1 - t^4) = 0.4444 * 0.98896 / 0.86508 = 0.50808.

    4 * 1.380649e-23 * 0.165^2 * 1e-10 * 0.50808 = 7.6392e-35 W^2/Hz, 8.740e-18 W/sqrt(Hz).
    """
    assert phonon_nep2(bolometer()) == pytest.approx(7.6392e-35, rel=1e-4)
    assert math.sqrt(phonon_nep2(bolometer())) == pytest.approx(8.740e-18, rel=1e-3)


@pytest.mark.parametrize("exponent", [0, 1, 2.7, 3])
@pytest.mark.parametrize("bath", [0.01, 0.1, 0.16])
def test_factor_is_mathers_integral(exponent, bath):
    """F = int (T k(T) / T_c k(T_c))^2 dT / int k(T) / k(T_c) dT from bath to bolometer, k as T^b (Mather 1982)."""
    warm = 0.165
    above = quad(lambda kelvin: ((kelvin / warm) ** (exponent + 1)) ** 2, bath, warm)[0]
    below = quad(lambda kelvin: (kelvin / warm) ** exponent, bath, warm)[0]
    found = phonon_nep2(bolometer(exponent=exponent, bath_temperature=f"{bath} K"))
    assert found == pytest.approx(4 * K * warm**2 * 1e-10 * above / below, rel=1e-9)


def test_factor_of_a_bath_as_warm_is_one():
    found = phonon_nep2(bolometer(bath_temperature="164.99 mK"))
    assert found == pytest.approx(4 * K * 0.165**2 * 1e-10, rel=5e-4)


@pytest.mark.parametrize("exponent", [0, 1, 3])
def test_saturation_power_is_the_integral_of_the_conductance(exponent):
    expected = quad(lambda kelvin: 100 * (kelvin / 0.165) ** exponent, 0.1, 0.165)[0]
    assert 1e12 * saturation_power_w(bolometer(exponent=exponent)) == pytest.approx(expected, rel=1e-9)


def test_recombination_noise_by_hand():
    """Aluminium: 0.19 meV = 3.0441e-23 J, 5 pW, 0.4: sqrt(4 * 3.0441e-23 * 5e-12 / 0.4) = 3.901e-17 W/sqrt(Hz)."""
    kid = Detector.model_validate(
        {"kid": {"gap": "0.19 meV", "pair_breaking_efficiency": 0.4, "amplifier_nep": "2e-17 W / Hz(1/2)"}}
    )
    terms = detector_nep2(kid, 5e-12)
    assert math.sqrt(terms["recombination"]) == pytest.approx(3.901e-17, rel=1e-3)
    assert terms["amplifier"] == pytest.approx(4e-34)
    assert recombination_nep2(0.0, 1e-23, 0.5) == 0


def test_terms_of_a_bolometer_do_not_depend_on_the_load():
    detector = Detector(bolometer=bolometer())
    assert detector_nep2(detector, 1e-12) == detector_nep2(detector, 0.0)
    assert detector_nep2(detector, 0.0) == {"phonon": phonon_nep2(bolometer()), "amplifier": pytest.approx(1e-34)}


def test_a_bath_that_is_not_colder():
    with pytest.raises(ValueError, match="bath_temperature: found 0.2 K; less than the critical temperature, 0.165 K"):
        bolometer(bath_temperature="200 mK")
