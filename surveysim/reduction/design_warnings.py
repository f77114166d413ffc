"""Warnings about the design of a survey: choices that are allowed and are seldom meant. They never stop a run.

`CHECKS` lists them. A new one is a function of the setup that returns a sentence, or nothing where all is well.
"""

import math
from collections.abc import Callable

import numpy as np

from mapmaker.uncertainty import FEWEST, draws
from surveysim.atmosphere.weather import survey_pwv_quantile
from surveysim.reduction.filter_checks import filtered_share
from surveysim.reduction.setup import Setup
from surveysim.runtime.numbers import plural
from surveysim.scene.detector_table import KEY
from surveysim.scene.spectra import NIGHT
from surveysim.telescope.optics import scene_chain
from surveysim.telescope.patterns.figures import Figure, covered_width
from surveysim.telescope.patterns.raster import Raster
from surveysim.telescope.patterns.track import Track, longest_gap
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.expected_losses import sampled_share
from surveysim.timestreams.fixed_sky import sky_notes
from surveysim.timestreams.observed_block import observation_levels
from surveysim.timestreams.simulation import boresight_path, camera_white, observation_path

MOST_APART = 0.02  # of two conversions to CMB temperature
MOST_LOST = 0.2  # of the samples
MOST_UNLIKE = 0.05  # of two apertures
FEWEST_IN_PART = 8  # observations, whose random signs know the noise of a part to about an eighth
MOST_FILTERED = 0.01  # of the white noise
LONG_GAP = 10  # in a track, in typical steps
FIRST = 4  # observations that tell the reach of a pattern
MOST_TURNED_RAD = math.radians(10)


def design_warnings(setup: Setup) -> list[str]:
    """Return a sentence for each questionable choice of a scene, in the order of `CHECKS`, and notes on its sky."""
    of_sky = sky_notes(setup.scene, _narrowest(setup))
    return [*(text for check in CHECKS if (text := check(setup))), *of_sky]


def _narrowest(setup: Setup) -> float:
    """Width of the narrowest beam [rad]."""
    beams = setup.camera.properties.beam_fwhm_rad
    return float(setup.scene.instrument.beam_fwhm_rad if beams is None else beams.min())


def _sampling(setup: Setup) -> str:
    scans, beam = setup.observing.scans, _narrowest(setup)
    step = scans.fastest_rad_s / scans.sample_rate_hz
    if step <= beam / 2 * (1 + 1e-9):
        return ""
    return (
        f"scan.sample_rate: samples are {_arcsec(step)} apart, more than half of the beam of {_arcsec(beam)}; a rate of"
        f" {2 * scans.fastest_rad_s / beam:.3g} Hz or more resolves it."
    )


def _track_gap(setup: Setup) -> str:
    scans = setup.observing.scans
    if not isinstance(scans, Track):
        return ""
    row, gap_s = longest_gap(scans)
    if gap_s <= LONG_GAP * scans.known_step_s:
        return ""
    return (
        f"scan.track_table: row {row} is {gap_s:.3g} s after the row before, and most rows {scans.known_step_s:.3g} s;"
        " samples between are interpolated."
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
    """Compare the scored patch with the area that the pattern, widened by the array, covers.

    That of rasters is what those along both axes have in common.
    """
    score, scans = setup.scene.score, setup.observing.scans
    if isinstance(scans, Raster):
        along, across = scans.speed_rad_s * setup.scene.scan.duration_s, (scans.n_scans - 1) * scans.step_rad
        width, covers = min(along, across), "scans in both directions cover"
        size = f"{_arcmin(along)} long, {_arcmin(across)} across"
    elif isinstance(scans, Figure):
        width, covers = covered_width(scans), f"the {setup.observing.pattern.name} covers"
        size = _arcmin(width)
    else:
        width, covers = _reached_width(setup), "the boresight reaches along an axis"
        size = _arcmin(width)
    covered = width + 2 * setup.camera.radius_rad + scans.dither_rad
    if score is None or score.size_rad <= covered * (1 + 1e-9):
        return ""
    return (
        f"score.size: the scored patch of {_arcmin(score.size_rad)} is larger than the {_arcmin(covered)} that {covers}"
        f" ({size}, and the array)."
    )


def _reached_width(setup: Setup) -> float:
    """Shorter side [rad] of the box that the boresight reaches in the first observations, without their dither."""
    paths = [boresight_path(setup.observing, number) for number in range(min(FIRST, setup.scene.observations))]
    sides = np.array([[np.ptp(path.xi_rad), np.ptp(path.eta_rad)] for path in paths])
    return float(sides.max(axis=0).min())


def _turning_raster(setup: Setup) -> str:
    """Warn of straight scans along which the array turns, as near the zenith: their layer has one angle a scan."""
    if setup.scene.schedule is None or not setup.observing.scans.straight or not setup.air.layers:
        return ""
    highest = int(setup.observing.angles.elevation_rad.max(axis=1).argmax())
    pointing = observation_path(setup.observing, highest)[1]
    at_centre = pointing.scan_array_angle_rad[np.searchsorted(np.unique(pointing.scan), pointing.scan)]
    turned = float(np.abs((pointing.array_angle_rad - at_centre + np.pi) % (2 * np.pi) - np.pi).max())
    if turned <= MOST_TURNED_RAD:
        return ""
    return (
        f"scan.pattern: along the scans of observation {highest} the array turns by {math.degrees(turned):.3g} deg from"
        " its angle at the field's centre, which is that of the turbulent layer; more than"
        f" {math.degrees(MOST_TURNED_RAD):.0f} deg change the layer's noise."
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


def _two_apertures(setup: Setup) -> str:
    """Compare the aperture that the layer is seen through with that of the optics, or its beam where that is wider."""
    scene = setup.scene
    if not setup.air.layers or scene.optics is None or scene.optics.aperture_m is None:
        return ""
    found, aperture = scene.atmosphere.illuminated_aperture_m, scene.optics.aperture_m
    spread = scene.atmosphere.layer_height_m * _narrowest(setup)
    if aperture * (1 - MOST_UNLIKE) <= found <= math.hypot(aperture, spread) * (1 + MOST_UNLIKE):
        return ""
    return (
        f"atmosphere.illuminated_aperture: pixels see the layer with {found:.4g} m, and optics.aperture is"
        f" {aperture:.4g} m; they are usually equal."
    )


def _unused_optics(setup: Setup) -> str:
    photon, optics = setup.scene.photon, setup.scene.optics
    if photon is None or photon.psd_mk2_hz is None or optics is None:
        return ""
    if not optics.elements and optics.stop is None and optics.sky_k is None:
        return ""
    return (
        "photon.psd: it sets the photon noise, and sky, stop and elements of [optics] do not enter; without 'psd' they"
        " do."
    )


def _unused_angle(setup: Setup) -> str:
    photon, polarizations = setup.scene.photon, setup.camera.polarizations
    if setup.camera.focal_plane.angle_rad is None:
        return ""
    if photon is None:
        found = "without [photon]"
    elif photon.coherence != "hbt":
        found = f"with photon.coherence {photon.coherence!r}"
    elif polarizations == 2:
        found = "with instrument.polarizations = 2"
    else:
        return ""
    return (
        f"{KEY}: column 'angle' does not change noise {found}; photon noise of coherence 'hbt' in one polarization"
        " depends on it."
    )


def _unused_efficiency(setup: Setup) -> str:
    properties = setup.camera.properties
    if properties.efficiency is None or properties.noise_is_power or setup.scene.photon:
        return ""
    return (
        f"{KEY}: column 'efficiency' changes nothing without [photon], as column 'psd' is the detector noise in"
        " temperature."
    )


def _conversions(setup: Setup) -> str:
    """Compare the conversion to CMB temperature of NETs, through median water, with that of maps."""
    scene = setup.scene
    if scene.photon is None or scene.photon.psd_mk2_hz is not None:
        return ""
    water, elevation_rad = setup.air.water, float(setup.observing.angles.elevation_rad.mean())
    pwv_mm = math.nan if water is None else float(survey_pwv_quantile(scene.atmosphere, setup.air.dated, 0.5))
    chain = scene_chain(scene, water.opacity if water else None, pwv_mm, elevation_rad)
    whole, band = chain.w_per_k / chain.w_per_k_cmb, scene.instrument.cmb_per_rj
    if abs(whole / band - 1) <= MOST_APART:
        return ""
    return (
        f"optics: NETs have {whole:.4g} K_CMB per K_RJ, through atmosphere and optics; maps and sigma(A) have"
        f" {band:.4g}, of the passband alone."
    )


def _lost_samples(setup: Setup) -> str:
    """Warn of a large expected share of lost samples, in the white noise of the first observation."""
    if not setup.scene.losses:
        return ""
    white = camera_white(setup.camera, observation_levels(setup, 0)).mean
    lost = 1 - float(sampled_share(setup.scene, np.array([white]))[0])
    if lost <= MOST_LOST:
        return ""
    names = ", ".join(f"[{name}]" for name in setup.scene.losses)
    return f"{names}: {100 * lost:.0f} % of the samples are lost; more than {100 * MOST_LOST:.0f} % are many."


def _arcsec(angle: float) -> str:
    return f"{math.degrees(angle) * 3600:.3g} arcsec"


def _arcmin(angle: float) -> str:
    return f"{math.degrees(angle) * 60:.3g} arcmin"


def _few_blocks(setup: Setup) -> str:
    """Warn of drifting weather with too few independent blocks for an error from their scatter."""
    block, scene = setup.air.block(setup.scene.observations), setup.scene
    if block is None or scene.score is None or (found := draws(len(block), block)) >= FEWEST:
        return ""
    return (
        f"atmosphere.correlation_time: with {scene.atmosphere.correlation_time_s / 3600:.3g} h the observations have"
        f" {plural(found, 'block')} of independent weather. The error of sigma(A) needs {FEWEST}, or 4 where there is a"
        " forecast."
    )


def _few_realizations(setup: Setup) -> str:
    """Warn of parts with few observations, and of realizations that do not suffice for a chi-squared."""
    section, splits = setup.scene.spectra, setup.analysis.splits
    if section is None:
        return ""
    score = setup.scene.score
    bins = (score.ell_max - score.ell_min) // section.ell_bin
    if section.realizations < bins + 3:
        return (
            f"spectra.realizations: {section.realizations} realizations do not measure the covariance of"
            f" {plural(bins, 'bin')}; {bins + 3} or more are needed for a chi-squared."
        )
    fewest = int(np.bincount(splits.night_parts).min()) if splits.of(NIGHT) else setup.scene.observations
    if fewest >= FEWEST_IN_PART:
        return ""
    return (
        f"spectra: a part has {plural(fewest, 'observation')}; {FEWEST_IN_PART} or more are needed to trust the errors"
        " of band powers and null tests."
    )


def _filtered_white(setup: Setup) -> str:
    """Warn of filters in time that remove noise from the range in which the white level is measured."""
    score, scans = setup.scene.score, setup.observing.scans
    if score is None:
        return ""
    share = filtered_share(setup.scene, samples_per_scan(scans), score.white_noise_above_hz)
    if share <= MOST_FILTERED:
        return ""
    return (
        f"score.white_noise_above: filters of cleaning.algorithm remove {100 * share:.0f} % of the noise above"
        f" {score.white_noise_above_hz:g} Hz, and the measured white level is lower by as much."
    )


CHECKS: tuple[Callable[[Setup], str], ...] = (
    _sampling,
    _track_gap,
    _diffraction,
    _pixels,
    _coverage,
    _turning_raster,
    _off_boresight,
    _two_apertures,
    _unused_optics,
    _unused_angle,
    _unused_efficiency,
    _conversions,
    _lost_samples,
    _few_blocks,
    _few_realizations,
    _filtered_white,
)
