"""Diffraction of a telescope: width of its beam and effective area, from the illumination of its aperture.

The field in the aperture is the square root of the illumination's intensity, in phase, between the central obscuration
and the edge. The far field at the angle theta is ``int a(u) J0(pi D theta u / lambda) u du`` over the radius u.
"""

import math

import numpy as np

from surveysim.runtime.errors import OutOfRangeError, SceneError
from surveysim.scene.scene import Scene
from surveysim.scene.units import LIGHT_M_S
from surveysim.telescope.focal_plane import illumination
from surveysim.telescope.illumination import Illumination

_NODES = 200  # of the radius; the field varies slowly
_NARROWEST_RAD, _WIDEST_RAD = math.radians(0.001 / 3600), math.radians(30)  # as of `instrument.beam_fwhm`
_WIDEST = 100.0  # FWHM [lambda / D] beyond which an illumination lights no aperture


def beam_width(lit: Illumination, obscuration: float = 0.0) -> float:
    """Full width at half maximum [lambda / D] of the diffracted beam: 1.029 of a uniform aperture.

    Parameters
    ----------
    lit
        Illumination of the aperture.
    obscuration
        Diameter of the central obscuration over that of the aperture.
    """
    from scipy.optimize import brentq
    from scipy.special import j0

    radius, weight = _field(lit, obscuration)
    peak = weight.sum()

    def above_half(width: float) -> float:
        return float(j0(np.pi * width / 2 * radius) @ weight / peak) - math.sqrt(0.5)

    step = 0.1
    edge = step
    while above_half(edge) > 0:
        edge += step
        if edge > _WIDEST:
            raise OutOfRangeError(
                f"found a beam wider than {_WIDEST:g} lambda / D; one that fills the aperture is allowed"
            )
    return float(brentq(above_half, edge - step, edge, xtol=1e-12))


def aperture_efficiency(lit: Illumination, obscuration: float = 0.0) -> float:
    """Effective area over that of the whole aperture, ``|int a dA|^2 / (A int a^2 dA)``: 1 for a uniform aperture.

    The integrals go from the obscuration to the edge. Light that spills over either is a loss of the optics.
    """
    radius, weight = _field(lit, obscuration)
    amplitude = np.sqrt(lit.intensity(radius))
    return float(2 * weight.sum() ** 2 / (weight @ amplitude))


def _field(lit: Illumination, obscuration: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of the radius, and quadrature weights times the field times the radius."""
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    radius = obscuration + (1 - obscuration) * (node + 1) / 2
    return radius, (1 - obscuration) / 2 * weight * radius * np.sqrt(lit.intensity(radius))


def _check_beam(aperture_m: float, fwhm_rad: float) -> None:
    if not _NARROWEST_RAD <= fwhm_rad <= _WIDEST_RAD:
        raise SceneError(
            f"optics.aperture: found {aperture_m:g} m, with a beam of {math.degrees(fwhm_rad) * 3600:.3g} arcsec; one "
            "of 0.001 arcsec to 30 deg is expected"
        )


def effective_area_m2(scene: Scene) -> float:
    """Effective area of the telescope for a point source in the centre of the beam [m^2].

    It is ``optics.aperture_efficiency`` times the area of the aperture, or else follows from the illumination. Without
    an aperture it is ``lambda^2 / Omega`` of the Gaussian beam, ``Omega = pi FWHM^2 / (4 ln 2)``.
    """
    optics, wavelength_m = scene.optics, LIGHT_M_S / scene.instrument.band.centre_hz
    if optics is None or optics.aperture_m is None:
        return wavelength_m**2 / (math.pi * scene.instrument.beam_fwhm_rad**2 / (4 * math.log(2)))
    share = optics.aperture_efficiency
    if share is None:
        share = aperture_efficiency(illumination(scene.instrument), optics.central_obscuration_m / optics.aperture_m)
    return share * math.pi * optics.aperture_m**2 / 4


def with_beam(scene: Scene) -> Scene:
    """Fill in the beam and the (f/#)lambda that a scene leaves to its aperture; others stay what they are.

    The wavelength is that of the centre of the band. One (f/#)lambda is lambda / D on the sky.
    """
    instrument = scene.instrument
    if instrument.beam_fwhm_rad is not None and instrument.f_lambda_rad is not None:
        return scene
    optics = scene.optics
    f_lambda_rad = LIGHT_M_S / instrument.band.centre_hz / optics.aperture_m
    changes = {}
    if instrument.f_lambda_rad is None:
        changes["f_lambda_rad"] = f_lambda_rad
    if instrument.beam_fwhm_rad is None:
        width = beam_width(illumination(instrument), optics.central_obscuration_m / optics.aperture_m)
        changes["beam_fwhm_rad"] = width * f_lambda_rad
        _check_beam(optics.aperture_m, width * f_lambda_rad)
    return scene.model_copy(update={"instrument": instrument.model_copy(update=changes)})
