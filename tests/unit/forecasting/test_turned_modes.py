"""Means over directions of scans against sums over evenly spaced azimuths."""

import numpy as np
import pytest

from surveysim.forecasting.mode_response import ring_modes
from surveysim.forecasting.turned_modes import turned_power

ELL = np.array([1000.0, 3000.0])
STEPS = 8192


def amplitude(angle, ell, speed):
    """Modes across the scan are lost; modes along it have a phase, whose sign is that of their direction."""
    along = ell * speed * np.cos(angle)
    return 1 - np.sinc(along) ** 2 + 0.1j * np.cos(angle) ** 3


def by_sums(directions, share, speeds, ell):
    """Azimuths and directions, one after the other."""
    psi, n = np.pi * np.arange(STEPS) / STEPS, directions.shape[-1]
    powers = []
    for place in directions:
        seen = np.zeros(STEPS, complex)
        for weights, speed in zip(place, speeds, strict=True):
            for number, weight in enumerate(weights):
                seen += weight * amplitude(psi - np.pi * number / n, ell, speed)
        powers.append(np.mean(np.abs(seen) ** 2))
    return share @ powers


def weights(kind, n_speed, n):
    rng = np.random.default_rng(4)
    found = {
        "one": np.eye(n)[3] * np.ones((1, n_speed, 1)),
        "right angle": (np.eye(n)[0] + np.eye(n)[n // 2]) * np.ones((2, n_speed, 1)),
        "all": rng.uniform(size=(3, n_speed, n)),
    }[kind]
    return found / found.sum(axis=(1, 2), keepdims=True)


@pytest.mark.parametrize("kind, tolerance", [("one", 1e-3), ("right angle", 1e-3), ("all", 3e-3)])
def test_power_is_that_of_mean_amplitudes(kind, tolerance):
    """Interpolation and nodes in azimuth limit it: one direction and right angles are nodes themselves."""
    speeds, modes = (3e-3, 5e-3), ring_modes(ELL)
    directions = weights(kind, len(speeds), 32)
    share = np.arange(1.0, len(directions) + 1) / np.arange(1, len(directions) + 1).sum()
    angle = np.angle(modes.wave)
    seen = np.array([amplitude(angle, ELL[:, None], speed) for speed in speeds])
    expected = [by_sums(directions, share, speeds, ell) for ell in ELL]
    np.testing.assert_allclose(turned_power(modes, seen, directions, share), expected, rtol=tolerance)
    assert max(expected) < 0.97


def test_scans_along_one_axis_keep_what_those_across_lose():
    modes = ring_modes(ELL)
    seen = amplitude(np.angle(modes.wave), ELL[:, None], 3e-3)[None]
    share, one, both = np.ones(1), weights("one", 1, 32), weights("right angle", 1, 32)[:1]
    alone = modes.mean((np.abs(seen[0]) ** 2).ravel())
    np.testing.assert_allclose(turned_power(modes, seen, one, share), alone, rtol=1e-9)
    assert (turned_power(modes, seen, both, share) < alone).all()
