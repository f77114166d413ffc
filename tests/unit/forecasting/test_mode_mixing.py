"""Mixing of multipoles by the taper across the scans, against sums over the modes of a map."""

import numpy as np
import pytest

from mapmaker.spectrum import annuli, mode_ell, ring_mean, tukey_taper
from surveysim.forecasting.mode_mixing import mode_mixing, taper_spectrum

SIZE, PIXEL, N = np.radians(40 / 60), np.radians(35 / 3600), 128
EDGES = np.arange(0, 8500, 500.0)


class Region:
    """Bins of a map twice as wide as its taper."""

    taper = tukey_taper(N, N, PIXEL, size_rad=SIZE, edge_fraction=0.5)
    rings = annuli(N, N, PIXEL, edges_ell=EDGES, taper=taper)


class Score:
    size_rad, taper_fraction = SIZE, 0.5


@pytest.fixture(scope="module")
def mixing():
    return mode_mixing(Region, Score)


def by_sums(spectrum):
    """Mean over the directions of the scans of the spectrum on the modes of a map, spread across the scans."""
    ell, total = mode_ell(N, N, PIXEL), 0.0
    k_x, k_y = 2 * np.pi * np.fft.rfftfreq(N, PIXEL), 2 * np.pi * np.fft.fftfreq(N, PIXEL)
    shift, power = taper_spectrum(SIZE, 0.5)
    for angle in np.pi * (np.arange(8) + 0.3) / 8:
        for q, share in zip(shift, power, strict=True):
            moved = np.hypot(k_x + q * np.cos(angle), k_y[:, None] + q * np.sin(angle))
            total = total + share * spectrum(moved) / 8
    return ring_mean(np.broadcast_to(total, ell.shape), Region.rings)


def test_a_flat_spectrum_is_unchanged(mixing):
    np.testing.assert_allclose(mixing.mixed(np.full((3, len(EDGES) - 1), 7.0)), 7.0, rtol=1e-12)
    assert not mixing.mixed(np.zeros(len(EDGES) - 1)).any()


def test_a_steep_spectrum_is_that_of_sums(mixing):
    """A spectrum that falls by 3 from bin to bin, and a floor, as of a layer and white noise."""

    def spectrum(ell):
        return np.exp(-ell / 450) + 1e-3

    found, expected = mixing.mixed(spectrum(Region.rings.ell)), by_sums(spectrum)
    inside = slice(3, -1)
    np.testing.assert_allclose(found[inside], expected[inside], rtol=0.06)
    assert np.all(expected[3:6] > 1.1 * spectrum(Region.rings.ell)[3:6])


def test_the_power_of_the_taper_has_the_variance_of_its_slope():
    """Parseval: the mean square of q is the integral of the squared slope over that of the square."""
    shift, power = taper_spectrum(SIZE, 0.5)
    edge = SIZE / 4  # each cosine edge
    expected = (np.pi / (2 * edge)) ** 2 * edge / (SIZE / 2 + 2 * edge * 3 / 8)
    assert power @ shift**2 == pytest.approx(expected, rel=0.01)
