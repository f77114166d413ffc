"""Correlation factors of a published calculator, bolojax 0.7.2, under its own assumptions.

It implements Hill and Kusaka (2024) with: the argument ``2 pi s rho`` of the Bessel function, where rho is 1 at the
edge of the stop (a uniform stop would have its first zero at 0.61 (f/#)lambda in place of 1.22); six neighbours at
every multiple of the pitch and of sqrt(3) times the pitch, out to 3 (f/#)lambda and at the nearest point of a grid;
gamma itself for light through the aperture and gamma^2 for the stop; an own factor for every element, combined as
square roots.
"""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import j0

from surveysim.telescope.illumination import TableIllumination

DATA = json.loads((Path(__file__).parent.parent / "data" / "bolojax" / "correlation.json").read_text())["presets"]
GRID = np.linspace(0, 5, 100)  # of its curves


def beam(preset):
    """Its intensity, and the outer edge of the stop's integral. Both have an edge that is 0.01 wide (tanh)."""
    rho = np.unique(np.concatenate([np.linspace(0, 1.2, 2401), np.linspace(0.9, 1.15, 5001)]))
    edge, outer = (1.05, 1.15) if preset == "he11" else (1.0, 1.1)
    shape = j0(2.4048255577 * rho / 1.05) ** 2 if preset == "he11" else np.exp(-2 * 1.33**2 * rho**2)
    rho, value = rho[rho <= outer], (shape * 0.5 * (1 - np.tanh((rho - edge) / 0.01)))[rho <= outer]
    return TableIllumination(tuple(rho.tolist()), tuple(value.tolist()))


def its_curves(preset, separation):
    """Its two curves, by the functions of this package."""
    light, twice = beam(preset), 2 * np.asarray(separation)
    return light.aperture(twice), light.stop(twice) ** 2


def its_factor(curve, pitch):
    """One plus its sum over neighbours."""
    shells = np.arange(1, round(3 / pitch) + 1)
    places = np.concatenate([shells * pitch, shells * pitch * np.sqrt(3)])
    nearest = np.abs(GRID - places[:, None]).argmin(axis=1)
    return 1 + 6 * np.abs(curve[nearest]).sum()


@pytest.mark.parametrize("preset", ["he11", "trunc_gauss"])
def test_curves(preset):
    aperture, stop = its_curves(preset, DATA[preset]["separation"])
    np.testing.assert_allclose(aperture, DATA[preset]["aperture"], rtol=0, atol=1e-5)
    np.testing.assert_allclose(stop, DATA[preset]["stop_squared"], rtol=0, atol=1e-5)


@pytest.mark.parametrize("preset", ["he11", "trunc_gauss"])
def test_factors(preset):
    aperture, stop = its_curves(preset, GRID)
    for pitch, (first, second, behind) in zip(DATA[preset]["pitch"], DATA[preset]["factors"], strict=True):
        assert its_factor(aperture, pitch) == pytest.approx(first, abs=1e-5)
        assert its_factor(stop, pitch) == pytest.approx(second, abs=1e-5)
        assert behind == 1
