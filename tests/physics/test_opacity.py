"""The four sites' fluctuation factors against those that Sayers et al. (2010) state, section 3.

The paper has another model of the atmosphere (ATM), profiles and bandpasses that it does not give. What these can
move was measured on this model, and each tolerance says it. Top-hat bands: 15 % at 143 and 268 GHz for
Bolocam, 30 and 50 GHz at 151 and 282 GHz for ACBAR.
"""

import numpy as np
import pytest

from surveysim.atmosphere.opacity import band_opacity, fluctuation_factor_mk2, optical_depth, optical_depth_slope
from surveysim.scene.passband import top_hat
from surveysim.scene.place import shipped_place

BOLOCAM = {143: 0.15, 268: 0.15}
ACBAR = {151: 30 / 151, 282: 50 / 282}
MEDIAN_MM = {"mauna_kea": 1.68, "south_pole": 0.25, "alma": 1.00, "ccat": 0.83}


def band(site, frequency_ghz):
    return band_opacity(shipped_place(site), top_hat(frequency_ghz * 1e9, (BOLOCAM | ACBAR)[frequency_ghz]))


def factor(site, frequency_ghz, pwv_mm=None):
    return fluctuation_factor_mk2(band(site, frequency_ghz), pwv_mm or MEDIAN_MM[site])


def test_268_over_143():
    """14.1, in temperature above the atmosphere, where the paper's model has 16 and its data 11, 14 and 14.

    3 GHz in the centre of either band are 14 and 6 %. From the ground it would be 12.1.
    """
    ratio = factor("mauna_kea", 268) / factor("mauna_kea", 143)
    assert ratio == pytest.approx(14.1, abs=0.05)
    assert ratio == pytest.approx(16, rel=0.14)
    assert ratio == pytest.approx(np.mean([11, 14, 14]), rel=0.15)


@pytest.mark.parametrize(
    ("site", "frequency_hz", "low"),
    [
        ("mauna_kea", 143e9, 1.11),
        ("mauna_kea", 268e9, 1.40),
        ("alma", 220e9, 1.15),
        ("alma", 345e9, 2.4),
        ("mauna_kea", 345e9, 4.0),
    ],
)
def test_streams_above_the_atmosphere(site, frequency_hz, low):
    """Over the emissivity's change as seen from the ground at 50 degrees, exp(2 tau / sin(el)) in power."""
    band = band_opacity(shipped_place(site), top_hat(frequency_hz, 0.15))
    pwv, step, airmass = MEDIAN_MM[site], 1e-3, 1 / np.sin(np.radians(50))
    ground = np.diff(1 - np.exp(-airmass * optical_depth(band, pwv + np.array([-step, step]))))[0] / (2 * step)
    seen = fluctuation_factor_mk2(band, pwv) / (pwv * ground / airmass * band.temperature_k * 1e3) ** 2
    assert seen == pytest.approx(low, rel=0.05)


def test_268_over_143_with_the_emissivity_as_printed():
    """The paper prints the emissivity as 1 - exp(+tau): that gives 16.4 for its 16 (14 % for 3 GHz at 143 GHz)."""
    printed = {f: factor("mauna_kea", f) * np.exp(2 * optical_depth(band("mauna_kea", f), 1.68)) for f in BOLOCAM}
    assert printed[268] / printed[143] == pytest.approx(16, rel=0.14)


@pytest.mark.parametrize("frequency_ghz", BOLOCAM)
def test_range_of_the_observations(frequency_ghz):
    """From 0.5 to 3.5 mm "almost two orders of magnitude": 49 from the column, the rest self broadening and depth."""
    ratio = factor("mauna_kea", frequency_ghz, 3.5) / factor("mauna_kea", frequency_ghz, 0.5)
    assert 40 < ratio < 100


@pytest.mark.parametrize("frequency_ghz", BOLOCAM)
def test_mauna_kea_over_alma(frequency_ghz):
    """3.5 in the paper; 2.8 in the column alone. A scale height of 1.5 km at Mauna Kea would add 14 %."""
    ratio = factor("mauna_kea", frequency_ghz) / factor("alma", frequency_ghz)
    assert ratio == pytest.approx(3.5, rel=0.14)


@pytest.mark.parametrize("frequency_ghz", BOLOCAM)
def test_ccat_below_alma(frequency_ghz):
    """The paper's 30 % is the column squared; thinner and colder air takes another 10 %."""
    ratio = factor("ccat", frequency_ghz) / factor("alma", frequency_ghz)
    assert ratio == pytest.approx(0.70, rel=0.15)
    alone = factor("alma", frequency_ghz, 0.83) / factor("alma", frequency_ghz)
    assert alone == pytest.approx(0.70, rel=0.04)
    assert ratio < alone


@pytest.mark.parametrize(("bolocam", "acbar", "stated"), [(143, 151, 12), (268, 282, 21)])
def test_mauna_kea_over_south_pole(bolocam, acbar, stated):
    """14.8 and 16.9 for 12 and 21 with one brightness at both sites, 19.0 and 21.6 with each site's own.

    The paper's own two numbers leave no room for the 28 % that the temperatures make: its ratios of
    (d eps / dC)^2, 0.30 and 0.45, times the columns squared are 13.6 and 20.3. Between vapour of scale height
    1 km and of constant relative humidity the ratio changes by 35 %.
    """
    mauna_kea, south_pole = band("mauna_kea", bolocam), band("south_pole", acbar)
    brightness = (mauna_kea.temperature_k / south_pole.temperature_k) ** 2
    ratio = factor("mauna_kea", bolocam) / factor("south_pole", acbar) / brightness
    assert ratio == pytest.approx(stated, rel=0.35)
    assert brightness == pytest.approx(1.28, rel=0.02)


def test_cold_thin_water_of_the_pole_absorbs_more_for_each_millimetre():
    """Two fifths more than Mauna Kea at 143 GHz, for pressure (680 over 620 mbar) and cold (230 K against 260 K)."""
    slope = {site: optical_depth_slope(band(site, 143), MEDIAN_MM[site]) for site in ("mauna_kea", "south_pole")}
    assert 1.1 * 680 / 620 < slope["south_pole"] / slope["mauna_kea"] < 1.5


def test_optical_depth_at_225_ghz():
    """0.080 for the paper's 0.091. Line wings that am cuts at 750 GHz would make it 0.092, air 10 K colder 0.086."""
    assert optical_depth(band_opacity(shipped_place("mauna_kea"), top_hat(225e9, 0.01)), 1.68) == pytest.approx(
        0.091, rel=0.15
    )
