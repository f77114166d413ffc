"""Closed forms and quadratures of the thin-screen atmosphere."""

import math

import numpy as np
import pytest
from scipy.special import j0

from surveysim.atmosphere.thin_screen import (
    Screen,
    beam_transfer,
    cross_psd,
    mean_removed_variance,
    pencil_structure_function,
    pencil_temporal_psd,
    power,
    structure_function,
    structure_slope,
    temporal_psd,
)

ARCMIN = math.radians(1.0 / 60.0)
KOLMOGOROV = Screen(11.0 / 3.0, 8.0 / 1000.0)


def brute_structure_function(screen, theta_rad):
    """4 pi int alpha P beam^2 (1 - J0) d alpha by trapezoids in ln alpha; below, 1 - J0 is quadratic."""
    low = 1e-4 if math.isinf(screen.outer_scale_rad) else 1e-4 / screen.outer_scale_rad
    alpha = np.geomspace(low, 2000.0 / screen.beam_rad, 500_001)
    beam = beam_transfer(alpha * screen.beam_rad)
    integrand = alpha**2 * power(screen, alpha) * beam**2 * (1.0 - j0(2.0 * np.pi * alpha * theta_rad))
    head = 0.0
    if math.isinf(screen.outer_scale_rad):
        head = (np.pi * theta_rad) ** 2 * low ** (4.0 - screen.index) / (4.0 - screen.index)
    return 4.0 * np.pi * (np.trapezoid(integrand, np.log(alpha)) + head)


@pytest.mark.parametrize(
    ("index", "height_m", "outer_scale_rad"),
    [
        (11 / 3, 1000.0, math.inf),
        (11 / 3, 375.0, math.inf),
        (11 / 3, 6000.0, 0.5),
        (3.9, 1000.0, math.inf),
        (2.0, 1000.0, math.inf),
        (4.5, 1000.0, 0.5),
        (20 / 3, 1000.0, 0.5),
        (2 / 3, 1000.0, 0.5),
        (2 / 3, 1000.0, math.inf),
    ],
)
def test_structure_function_is_the_integral(index, height_m, outer_scale_rad):
    screen = Screen(index, 8.0 / height_m, outer_scale_rad)
    theta = np.array([0.03, 1.4, 1.6, 30.0]) * screen.beam_rad  # 1.5 beams is where the two methods meet
    # The brute integral ends at alpha D = 2000: for b = 2/3 at 0.03 beams that leaves out 2e-5.
    expected = [brute_structure_function(screen, t) for t in theta]
    np.testing.assert_allclose(structure_function(screen, theta), expected, rtol=5e-5)


def test_structure_function_scales_with_the_beam():
    theta = np.geomspace(1e-3, 100.0, 40)
    wide, narrow = Screen(3.2, 0.02), Screen(3.2, 0.001)
    ratio = structure_function(wide, theta * 0.02) / structure_function(narrow, theta * 0.001)
    np.testing.assert_allclose(ratio, 20.0**1.2, rtol=1e-9)


def test_structure_function_is_continuous_in_the_index_at_two():
    theta = np.array([0.1, 10.0]) * ARCMIN * 30.0
    below, at, above = (structure_function(Screen(b, 0.008), theta) for b in (1.999, 2.0, 2.001))
    np.testing.assert_allclose(at, np.sqrt(below * above), rtol=1e-5)


def test_structure_function_at_its_ends():
    assert structure_function(KOLMOGOROV, 0.0) == 0.0
    tiny = structure_function(KOLMOGOROV, np.array([1e-6, 2e-6]) * KOLMOGOROV.beam_rad)
    assert tiny[1] / tiny[0] == pytest.approx(4.0, rel=1e-6)  # a gradient
    with pytest.raises(ValueError, match="beams found"):
        structure_function(KOLMOGOROV, 1e5 * KOLMOGOROV.beam_rad)


def test_structure_function_with_outer_scale_saturates():
    screen = Screen(11 / 3, 0.008, 0.05)
    assert structure_function(screen, 1.0) == pytest.approx(structure_function(screen, 3.0), rel=1e-6)


def test_structure_slope_is_the_derivative():
    theta = np.array([1.0, 30.0, 700.0]) * ARCMIN
    difference = structure_function(KOLMOGOROV, theta * 1.0001) - structure_function(KOLMOGOROV, theta * 0.9999)
    np.testing.assert_allclose(structure_slope(KOLMOGOROV, theta), difference / (2e-4 * theta), rtol=1e-5)


def test_pencil_limit():
    assert pencil_structure_function(11 / 3, 1.0) == pytest.approx(300.66, abs=0.01)
    theta = 3000.0 * KOLMOGOROV.beam_rad
    for index in (2.5, 3.0, 11 / 3):
        # The beam takes off its own constant, of the order of D at one beam.
        screen = Screen(index, KOLMOGOROV.beam_rad)
        pencil = pencil_structure_function(index, theta)
        assert structure_function(screen, theta) == pytest.approx(pencil, rel=1.2 * 3000.0 ** (2.0 - index))
    with pytest.raises(ValueError, match="2 < b < 4"):
        pencil_structure_function(4.0, theta)


def test_temporal_psd_in_the_pencil_limit():
    speed = 31.0 * ARCMIN
    f = 1e-3 * speed / KOLMOGOROV.beam_rad
    for index in (2.5, 11 / 3):
        psd = temporal_psd(Screen(index, KOLMOGOROV.beam_rad), f, speed)
        assert psd == pytest.approx(pencil_temporal_psd(index, f, speed), rel=3e-3 if index < 3 else 1e-4)
    with pytest.raises(ValueError, match="b > 1"):
        pencil_temporal_psd(1.0, f, speed)


@pytest.mark.parametrize("screen", [KOLMOGOROV, Screen(4.5, 0.008, 0.5), Screen(2.5, 0.0013), Screen(2 / 3, 0.008)])
def test_psd_and_structure_function_are_one_field(screen):
    """D(theta) = 2 int S(f) (1 - cos(2 pi f theta / w)) df, two quite different quadratures."""
    speed, theta = 0.01, np.array([0.3, 3.0]) * screen.beam_rad
    f = np.concatenate([np.geomspace(1e-10, 0.3, 800), np.arange(0.3, 30.0, 2e-2)[1:]]) * speed / screen.beam_rad
    psd = temporal_psd(screen, f, speed)
    for t in theta:
        integrand = 2.0 * psd * (1.0 - np.cos(2.0 * np.pi * f * t / speed))
        # b = 2/3 still has 0.2 % beyond the end at thirty inverse beams.
        assert np.trapezoid(integrand, f) == pytest.approx(structure_function(screen, t), rel=3e-3)


def test_cross_psd_is_a_structure_function_across_the_wind():
    """D(dy) = 2 int (S(f, 0) - S(f, dy)) df."""
    speed, dy = 0.01, 4.0 * ARCMIN
    f = np.geomspace(1e-7, 20.0, 1500) * speed / KOLMOGOROV.beam_rad
    difference = temporal_psd(KOLMOGOROV, f, speed) - cross_psd(KOLMOGOROV, f, speed, dy)
    # What lies below the first frequency goes as f^(1/3).
    below = 3.0 * f[0] * difference[0]
    total = 2.0 * (np.trapezoid(difference * f, np.log(f)) + below)
    assert total == pytest.approx(structure_function(KOLMOGOROV, dy), rel=2e-3)


def test_psd_refuses_frequency_zero():
    with pytest.raises(ValueError, match="positive"):
        temporal_psd(KOLMOGOROV, np.array([0.0, 1.0]), 0.01)


def test_mean_removed_variance():
    """304.4 mK^2 from the structure function, and from the PSD with what lies below its first bin."""
    speed, duration_s = 31.0 * ARCMIN, 15.0
    variance = mean_removed_variance(KOLMOGOROV, speed, duration_s)
    f = np.geomspace(1e-7, 20.0, 4001)
    psd = temporal_psd(KOLMOGOROV, f, speed)
    below = psd[0] * f[0] ** 3 * 3.0 * (np.pi * duration_s) ** 2 / 3.0  # f^(-8/3) (pi f T)^2 / 3 from 0 to f[0]
    by_psd = np.trapezoid(psd * f * (1.0 - np.sinc(f * duration_s) ** 2), np.log(f)) + below
    assert variance == pytest.approx(by_psd, rel=1e-4)
    assert 280.0 * variance == pytest.approx(304.4, abs=0.1)


@pytest.mark.parametrize("index", [4.0, 20 / 3])
def test_steep_spectrum_needs_an_outer_scale(index):
    with pytest.raises(ValueError, match=r"found without an outer scale.*b < 4 is allowed"):
        Screen(index, 0.008)


@pytest.mark.parametrize("values", [(0.0, 0.008), (math.nan, 0.008), (3.0, 0.0), (3.0, math.inf), (3.0, 0.008, 0.001)])
def test_impossible_screens(values):
    with pytest.raises(ValueError, match="is allowed"):
        Screen(*values)
