"""FittedModes that a fit takes from a scan in time: closed forms against quadrature and draws."""

import numpy as np
import pytest

from mapmaker.spectrum import tukey
from surveysim.atmosphere.thin_screen import Screen
from surveysim.forecasting.fitted_modes import NO_FITTED_MODES, FittedModes, expected_mode_shares, template_modes
from surveysim.forecasting.mode_response import layer_waves
from surveysim.forecasting.scan_apodization import apodization_of

SECONDS, SAMPLES = 15.0, 150
TIME = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / SAMPLES * SECONDS
SPEED_RAD_S = np.radians(31 / 60)


def _layer():
    """Frequencies and powers of a Kolmogorov layer at the paper's median wind."""
    layer = layer_waves(Screen(11 / 3, 8e-3, np.inf), SPEED_RAD_S * SECONDS)
    return (layer.alpha * SPEED_RAD_S).real, layer.power[0]


def _templates(draws: int) -> np.ndarray:
    """Templates (draws, SAMPLES) of these waves, less their means and of unit norm."""
    frequency, power = _layer()
    phase, rng = 2 * np.pi * np.outer(frequency, TIME), np.random.default_rng(1)
    cos, sin = (np.sqrt(power)[:, None] * wave for wave in (np.cos(phase), np.sin(phase)))
    found = rng.standard_normal((draws, len(power))) @ cos + rng.standard_normal((draws, len(power))) @ sin
    found -= found.mean(axis=1, keepdims=True)
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("variance", [[1.0], [1.0, 1.0, 1.0], [1.0, 0.05, 0.02], [3.0, 0.0, 1e-6]])
def test_expected_shares_are_those_of_draws(variance):
    draws = 100_000
    z = np.random.default_rng(2).standard_normal((draws, len(variance))) ** 2 * variance
    share = z / z.sum(axis=1, keepdims=True)
    found = expected_mode_shares(np.array(variance))
    assert found.sum() == pytest.approx(1, rel=1e-12)
    np.testing.assert_allclose(found, share.mean(axis=0), atol=4 * 0.5 / np.sqrt(draws))


def test_components_of_waves_are_integrals():
    fitted_modes = FittedModes(np.full(5, 0.2), np.eye(5))
    frequency = np.array([-0.9, -0.05, 0.0, 0.02, 0.31, 2.2])
    time = (np.arange(40_000) + 0.5) / 40_000 * SECONDS - SECONDS / 2
    shapes = fitted_modes.at(time, SECONDS)
    np.testing.assert_allclose(shapes @ shapes.T * SECONDS / 40_000, np.eye(5), atol=1e-6)
    np.testing.assert_array_equal(fitted_modes.odd, [True, False, True, False, True])
    for f, found in zip(frequency, fitted_modes.wave_components(frequency, SECONDS), strict=True):
        wave = np.where(fitted_modes.odd[:, None], np.sin(2 * np.pi * f * time), np.cos(2 * np.pi * f * time))
        np.testing.assert_allclose(found, np.sum(wave * shapes, axis=1) * SECONDS / 40_000, atol=1e-6)


def test_fitted_modes_of_a_layer_are_modes_of_drawn_templates():
    """The expected projector onto the template, 3000 draws: a share by a share of at most a half to 4 sigma and 2 %."""
    fitted_modes = template_modes(*_layer(), SECONDS)
    assert 0.93 < fitted_modes.share.sum() < 1 and 0.6 < fitted_modes.share.max() < 0.8
    shapes = fitted_modes.at(TIME, SECONDS) * np.sqrt(SECONDS / SAMPLES)
    found = np.mean((_templates(3000) @ shapes.T) ** 2, axis=0)
    np.testing.assert_allclose(found, fitted_modes.share, atol=0.02 + 4 * 0.5 / np.sqrt(3000))


def test_noise_of_a_mode_is_what_scans_less_templates_leave():
    """White scans less their mean and their component along a drawn template: 10 000 powers, exponential."""
    draws, rng = 10_000, np.random.default_rng(3)
    scans, templates = rng.standard_normal((draws, SAMPLES)), _templates(draws)
    scans -= scans.mean(axis=1, keepdims=True)
    scans -= np.einsum("ij,ij->i", scans, templates)[:, None] * templates
    taper = tukey(SAMPLES, 1.0, SAMPLES, 0.5)
    at_hz = np.array([0.0, 0.02, 0.05, 0.1, 0.4])
    found = np.mean(np.abs((scans * taper) @ np.exp(-2j * np.pi * np.outer(TIME, at_hz))) ** 2, axis=0)
    found /= np.sum(taper**2)
    nodes = np.linspace(-5, 5, 8001)
    strength = np.full((1, len(nodes)), nodes[1] - nodes[0])
    step = SECONDS / SAMPLES
    expected, plain = (
        apodization_of(SECONDS, taper, step, fitted_modes).sums(strength, nodes, at_hz)
        for fitted_modes in (template_modes(*_layer(), SECONDS), NO_FITTED_MODES)
    )
    np.testing.assert_allclose(found, expected, rtol=4 * np.sqrt(2 / draws) + 0.02)
    assert expected[2] < 0.8 * plain[2] and expected[4] > 0.98 * plain[4]


def test_passed_is_what_templates_leave_of_a_wave():
    """The mean of 3000 templates, to 4 sigma of at most 0.3 / sqrt(3000); modes that few scans lose are left out."""
    fitted_modes, taper = template_modes(*_layer(), SECONDS), tukey(SAMPLES, 1.0, SAMPLES, 0.5)
    apodization = apodization_of(SECONDS, taper, SECONDS / SAMPLES, fitted_modes)
    templates = _templates(3000)
    for f in (0.0, 0.03, 0.11, -0.2):
        wave = np.exp(2j * np.pi * f * TIME)
        left = np.sum((wave - wave.mean()) * taper * wave.conj())
        left = (left - np.mean((templates @ wave) * (templates @ (taper * wave.conj())))) / taper.sum()
        assert apodization.signal_amplitude(f) == pytest.approx(left.real, abs=0.03)


def test_a_fit_to_many_scans_takes_as_little_of_each():
    fitted_modes = template_modes(*_layer(), SECONDS)
    taper, step, f = tukey(SAMPLES, 1.0, SAMPLES, 0.5), SECONDS / SAMPLES, np.array([0.05])
    none, shared, all_of_it = (
        apodization_of(SECONDS, taper, step, item).signal_amplitude(f)[0]
        for item in (NO_FITTED_MODES, fitted_modes.scaled(1 / 18), fitted_modes)
    )
    assert none - shared == pytest.approx((none - all_of_it) / 18, rel=1e-9)
