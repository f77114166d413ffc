"""Transforms of circular sources on the sky: point sources in a beam, and clusters of galaxies.

A profile is the flat-sky Fourier transform of a source whose centre has the value 1, ``2 pi int p(theta) J0(ell theta)
theta dtheta`` [sr], as a function of multipole.
"""

import math

import numpy as np

from mapmaker.validation import number, reals

# Generalized NFW profile of the pressure of clusters (Arnaud et al. 2010, A&A 517, A92, eq. 12).
CONCENTRATION, GAMMA, ALPHA, BETA = 1.177, 0.3081, 1.0510, 5.4905
EDGE = 5.0  # radius of the cluster [R500], that of Y_5R500 in the same paper
_NODES = 200  # of the radius
_INNERMOST = 1e-8  # radius [R500] within which 1e-5 of the line of sight's pressure lies


def gaussian_profile(ell: np.ndarray, fwhm_rad: float) -> np.ndarray:
    """Profile of a point source in a Gaussian beam: ``2 pi s^2 exp(-ell^2 s^2 / 2)``, s = fwhm / sqrt(8 ln 2).

    Parameters
    ----------
    ell : any shape
    fwhm_rad
        Full width at half maximum.

    Returns
    -------
    array
        [sr].

    Raises
    ------
    ValueError
        For multipoles that are not finite, and a beam that is not positive.
    """
    variance = number("fwhm_rad", fwhm_rad, above=0, most=math.pi) ** 2 / (8 * math.log(2))
    return 2 * np.pi * variance * np.exp(-(reals("ell", ell, (...,)) ** 2) * variance / 2)


def beta_profile(ell: np.ndarray, core_radius_rad: float, beta: float) -> np.ndarray:
    """Profile of ``(1 + theta^2 / theta_c^2)^((1 - 3 beta) / 2)``, an isothermal cluster.

    It is ``2 pi theta_c^2 (x / 2)^(m - 1) K_{m-1}(x) / Gamma(m)`` with x = ell theta_c and m = (3 beta - 1) / 2.

    Parameters
    ----------
    ell : any shape
        Above 0: for beta of 1 and less the profile diverges at 0.
    core_radius_rad
        theta_c.
    beta
        Above 1/3, where the source falls with radius.

    Returns
    -------
    array
        [sr].

    Raises
    ------
    ValueError
        For multipoles that are not positive, and radii and slopes out of range.
    """
    from scipy.special import kv

    radius = number("core_radius_rad", core_radius_rad, above=0, most=math.pi)
    slope = (3 * number("beta", beta, above=1 / 3, most=10) - 1) / 2
    x = reals("ell", ell, (...,), above=0) * radius
    return 2 * np.pi * radius**2 * (x / 2) ** (slope - 1) * kv(slope - 1, x) / math.gamma(slope)


def arnaud_profile(ell: np.ndarray, theta_500_rad: float) -> np.ndarray:
    """Profile of the universal pressure profile of clusters (Arnaud et al. 2010), cut at 5 R500.

    The pressure ``(c x)^-gamma (1 + (c x)^alpha)^((gamma - beta) / alpha)`` at the radius x R500, projected along the
    line of sight.

    Parameters
    ----------
    ell : any shape
    theta_500_rad
        Angle of R500.

    Returns
    -------
    array
        [sr].

    Raises
    ------
    ValueError
        For multipoles that are not finite, and an angle that is not positive.
    """
    theta = number("theta_500_rad", theta_500_rad, above=0, most=math.pi)
    multipole = reals("ell", ell, (...,))
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    span = math.log(EDGE / _INNERMOST)
    x = EDGE * np.exp(span * (node - 1) / 2)
    scaled = CONCENTRATION * x
    pressure = scaled**-GAMMA * (1 + scaled**ALPHA) ** ((GAMMA - BETA) / ALPHA)
    measure = weight * span / 2 * x * pressure  # dx times the pressure
    wave = np.sinc(multipole[..., None] * theta * x / np.pi)
    return theta**2 * 2 * np.pi * (wave @ (measure * x**2)) / measure.sum()
