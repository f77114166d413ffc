"""Filters in time of a forecast against the cleaning that they stand for, wave by wave."""

import numpy as np
import pytest

from mapmaker.cleaning import HighpassOptions, NotchOptions, TimePolynomialOptions, clean_in_order
from mapmaker.cleaning.time_filters import time_modes
from mapmaker.spectrum import tukey
from mapmaker.timestreams import FocalPlane
from surveysim.forecasting.fitted_modes import NO_FITTED_MODES, FittedModes, template_modes
from surveysim.forecasting.scan_apodization import apodization_of
from surveysim.forecasting.time_filters import ScanFilters, product

SAMPLES, RATE = 120, 10.0
SECONDS = SAMPLES / RATE
TIME_S = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / RATE
SHARP, NOTCH = ("highpass", HighpassOptions(0.22, RATE)), ("notch", NotchOptions((1.7,), (0.1,), RATE))
SMOOTH, LINE = ("highpass", HighpassOptions(0.3, RATE, 3)), ("time_polynomial", TimePolynomialOptions(2))
CASES = [([SHARP], []), ([LINE, SMOOTH], [NOTCH]), ([], [NOTCH, SHARP])]
AT_HZ = np.array([-1.75, 0.02, 0.31, 1.64])
WAVES_HZ = np.array([-0.3, 0.003, 0.05, 0.11, 0.6, 1.71, 4.0])


def _filters(before, after):
    sides = [product((time_modes(options, SAMPLES) for _, options in steps), SAMPLES) for steps in (before, after)]
    return ScanFilters(*sides, RATE)


def _apply(steps, columns):
    """Filter columns (n_samp, n) as cleaning does; without steps their means go."""
    streams = np.ascontiguousarray(columns.T)
    plane = FocalPlane(*np.zeros((2, len(streams))), fwhm_rad=1e-4)
    return clean_in_order([*steps, ("none", None)], streams, np.array([[0, SAMPLES]]), plane).data_mk.T


def _apodization(before, after, fitted=NO_FITTED_MODES):
    taper = tukey(SAMPLES, 1.0, SAMPLES, 0.5)
    return apodization_of(SECONDS, taper, 1 / RATE, fitted, _filters(before, after)), taper


def _waves(at_hz):
    return np.exp(2j * np.pi * np.outer(TIME_S, at_hz))


@pytest.mark.parametrize(("before", "after"), CASES)
@pytest.mark.parametrize("fitted", [False, True])
def test_leakage_is_the_power_of_filtered_waves(before, after, fitted):
    """A fit removes the second Legendre polynomial between the filters, from all scans."""
    modes = FittedModes(np.ones(1), np.eye(3)[1:2]) if fitted else NO_FITTED_MODES
    apodization, taper = _apodization(before, after, modes)
    waves = _waves(WAVES_HZ)
    seen = [_apply(before, part) for part in (waves.real, waves.imag)]
    if fitted:
        mode = modes.at(TIME_S, SECONDS).T / np.sqrt(RATE)
        seen = [part - mode @ (mode.T @ part) for part in seen]
    real, imaginary = (_apply(after, part) for part in seen)
    tapered = (taper * np.sqrt(1 / RATE / np.sum(taper**2)))[:, None] * _waves(AT_HZ)
    expected = np.abs(tapered.conj().T @ (real + 1j * imaginary)) ** 2
    found = [apodization.sums(np.ones((1, 1)), np.array([f]), AT_HZ) for f in WAVES_HZ]
    # The smooth high-pass omits modes that lose less than 0.1 %, and the look-up is linear.
    np.testing.assert_allclose(np.array(found).T, expected, atol=2e-4 * apodization.transfer[0] ** 2)


@pytest.mark.parametrize(("before", "after"), CASES)
def test_signal_keeps_its_own_part(before, after):
    apodization, taper = _apodization(before, after)
    waves = _waves(AT_HZ)
    real, imaginary = (_apply([*before, *after], part) for part in (waves.real, waves.imag))
    expected = np.sum(taper[:, None] * (waves.conj() * (real + 1j * imaginary)).real, axis=0) / taper.sum()
    np.testing.assert_allclose(apodization.signal_amplitude(AT_HZ), expected, atol=1e-3)


@pytest.mark.parametrize(("before", "after"), CASES)
def test_kept_power_is_that_of_white_noise(before, after):
    operator = _apply([*before, *after], np.eye(SAMPLES))
    kept = _filters(before, after).total.kept_power
    assert kept - 1 / SAMPLES == pytest.approx(np.sum(operator**2) / SAMPLES, abs=1e-3)


def test_layers_of_any_strength_cancel():
    """A straight line that a sharp high-pass and a polynomial remove leaves less than 1e-7 of its power."""
    apodization, _ = _apodization([LINE, SHARP], [])
    left = apodization.sums(np.ones((1, 1)), np.array([1e-3]), AT_HZ)
    through = apodization.sums(np.ones((1, 1)), np.array([1e-3]), np.array([0.0])) + apodization.transfer[0] ** 2
    assert left.max() < 1e-7 * through[0]


def test_fits_follow_filtered_templates():
    """A template of a red spectrum is nearly a line; without powers up to the second, it is of the third degree."""
    at_hz = np.geomspace(1e-3, 1, 200)
    power = at_hz ** (-8 / 3) * np.gradient(at_hz)
    alone = template_modes(at_hz, power, SECONDS)
    after = template_modes(at_hz, power, SECONDS, _filters([LINE], []).before)
    leading = [np.argmax(np.abs(item.degrees[np.argmax(item.share)])) + 1 for item in (alone, after)]
    assert leading == [1, 3] and after.degrees[np.argmax(after.share)][0] == pytest.approx(0, abs=1e-6)
