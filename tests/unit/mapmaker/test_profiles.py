"""Profiles of sources: closed forms beside brute-force integrals over the sky."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0

from mapmaker.profiles import ALPHA, BETA, CONCENTRATION, EDGE, GAMMA, arnaud_profile, beta_profile, gaussian_profile

ARCMIN = np.radians(1 / 60)


def hankel(shape, ell, upto):
    """2 pi int p(theta) J0(ell theta) theta dtheta by trapezia, finer inwards."""
    theta = np.concatenate([[0.0], np.geomspace(1e-5 * upto, upto, 200_000)])
    return 2 * np.pi * np.trapezoid(shape(theta) * j0(ell * theta) * theta, theta)


@pytest.mark.parametrize("ell", [10.0, 3000.0, 12000.0])
def test_gaussian(ell):
    sigma = ARCMIN / np.sqrt(8 * np.log(2))
    expected = hankel(lambda t: np.exp(-(t**2) / (2 * sigma**2)), ell, 9 * sigma)
    assert gaussian_profile(np.array(ell), ARCMIN) == pytest.approx(expected, rel=1e-7)


@pytest.mark.parametrize("ell", [500.0, 3000.0])
def test_beta(ell):
    """A steep one, whose integral ends; those of usual slopes converge only with the waves."""
    expected = hankel(lambda t: (1 + (t / ARCMIN) ** 2) ** -2.5, ell, 300 * ARCMIN)
    assert beta_profile(np.array(ell), ARCMIN, beta=2.0) == pytest.approx(expected, rel=1e-6)


def test_beta_of_one_is_a_bessel_function():
    """2 pi theta_c^2 K_0(ell theta_c)."""
    from scipy.special import k0

    ell = np.array([200.0, 2000.0])
    expected = 2 * np.pi * ARCMIN**2 * k0(ell * ARCMIN)
    np.testing.assert_allclose(beta_profile(ell, ARCMIN, beta=1.0), expected, rtol=1e-12)


def line_of_sight(theta):
    """Pressure along a line at the distance theta [R500] from the centre."""

    def pressure(depth):
        x = CONCENTRATION * np.hypot(theta, depth)
        return x**-GAMMA * (1 + x**ALPHA) ** ((GAMMA - BETA) / ALPHA)

    edge = np.sqrt(EDGE**2 - theta**2)
    return sum(quad(pressure, *pair, limit=200)[0] for pair in ((0, min(0.1, edge)), (min(0.1, edge), edge)))


@pytest.mark.parametrize("ell", [100.0, 2000.0, 8000.0])
def test_arnaud(ell):
    """Line of sight first, then the plane of the sky; the program does both at once."""
    scale, centre = 3 * ARCMIN, line_of_sight(0.0)
    theta = np.concatenate([[0.0], np.geomspace(1e-4, EDGE, 400)])
    projected = np.array([line_of_sight(t) / centre for t in theta])
    expected = hankel(lambda t: np.interp(t / scale, theta, projected), ell, EDGE * scale)
    assert arnaud_profile(np.array(ell), scale) == pytest.approx(expected, rel=2e-3)


def test_arnaud_total_is_the_published_integral():
    """Y of spheres of 5 R500 and R500: I(5) / I(1) = 1.1037 / 0.6145, with parameters of four digits."""
    ell = np.array(1e-3)
    sphere = [quad(lambda x: 4 * np.pi * x**2 * line_of_sight_pressure(x), 0, radius)[0] for radius in (1, EDGE)]
    assert sphere[1] / sphere[0] == pytest.approx(1.1037 / 0.6145, rel=5e-4)
    total = sphere[1] / (2 * line_of_sight(0.0)) * ARCMIN**2
    assert arnaud_profile(ell, ARCMIN) == pytest.approx(total, rel=1e-4)


def line_of_sight_pressure(x):
    scaled = CONCENTRATION * x
    return scaled**-GAMMA * (1 + scaled**ALPHA) ** ((GAMMA - BETA) / ALPHA)
