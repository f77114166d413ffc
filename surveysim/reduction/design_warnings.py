"""Warnings about the design of a survey: choices that are allowed and are seldom meant. They never stop a run.

`CHECKS` lists them. A new one is a function of the setup that returns a sentence, or nothing where all is well.
"""

import math
from collections.abc import Callable

import numpy as np

from surveysim.reduction.setup import Setup


def design_warnings(setup: Setup) -> list[str]:
    """Return a sentence for each questionable choice of a scene, in the order of `CHECKS`."""
    return [text for check in CHECKS if (text := check(setup))]


def _narrowest(setup: Setup) -> float:
    """Width of the narrowest beam [rad]."""
    beams = setup.camera.properties.beam_fwhm_rad
    return float(setup.scene.instrument.beam_fwhm_rad if beams is None else beams.min())


def _sampling(setup: Setup) -> str:
    scans, beam = setup.observing.scans, _narrowest(setup)
    step = scans.speed_rad_s / scans.sample_rate_hz
    if step <= beam / 2 * (1 + 1e-9):
        return ""
    return (
        f"scan.sample_rate: samples are {_arcsec(step)} apart, more than half of the beam of {_arcsec(beam)}; a rate of"
        f" {2 * scans.speed_rad_s / beam:.3g} Hz or more resolves it."
    )


def _diffraction(setup: Setup) -> str:
    beam, limit = _narrowest(setup), setup.camera.f_lambda_rad
    if beam >= limit * (1 - 1e-9):
        return ""
    return (
        f"instrument.beam_fwhm: the beam of {_arcsec(beam)} is narrower than lambda/D = {_arcsec(limit)}, which is"
        " instrument.f_lambda; a uniformly illuminated aperture has 1.03 lambda/D."
    )


def _pixels(setup: Setup) -> str:
    pixel, beam = setup.scene.map.pixel_rad, _narrowest(setup)
    if pixel <= beam / 2 * (1 + 1e-9):
        return ""
    return f"map.pixel: pixels of {_arcsec(pixel)} are larger than half of the beam of {_arcsec(beam)}."


def _coverage(setup: Setup) -> str:
    """Compare the scored patch with the area that rasters along both axes, widened by the array, have in common."""
    score, scan = setup.scene.score, setup.scene.scan
    if score is None:
        return ""
    along, across = scan.speed_rad_s * scan.duration_s, (scan.scans - 1) * scan.step_rad
    covered = min(along, across) + 2 * setup.camera.radius_rad + scan.dither_rad
    if score.size_rad <= covered * (1 + 1e-9):
        return ""
    return (
        f"score.size: the scored patch of {_arcmin(score.size_rad)} is larger than the {_arcmin(covered)} that scans in"
        f" both directions cover ({_arcmin(along)} long, {_arcmin(across)} across, and the array)."
    )


def _off_boresight(setup: Setup) -> str:
    plane = setup.camera.focal_plane
    positions = np.column_stack([plane.x_rad, plane.y_rad])
    low, high = positions.min(axis=0), positions.max(axis=0)
    offset, reach = float(np.hypot(*(low + high) / 2)), float(np.hypot(*(high - low) / 2))
    if offset <= max(reach, 2 * _narrowest(setup)):
        return ""
    return (
        f"instrument: the middle of the array is {_arcmin(offset)} off the boresight, beyond its own half width of"
        f" {_arcmin(reach)}; the telescope points at the field's centre with the boresight."
    )


def _arcsec(angle: float) -> str:
    return f"{math.degrees(angle) * 3600:.3g} arcsec"


def _arcmin(angle: float) -> str:
    return f"{math.degrees(angle) * 60:.3g} arcmin"


CHECKS: tuple[Callable[[Setup], str], ...] = (_sampling, _diffraction, _pixels, _coverage, _off_boresight)
