"""Consistency of the sections of a scene: errors that depend on the camera or the map."""

import math
from collections.abc import Mapping

import numpy as np

from mapmaker.bandpower import flat_spectrum_psd
from mapmaker.cleaning import TEMPLATE_CLEANINGS, TIME_FILTERS
from mapmaker.cleaning.responsivity import OBSERVATION, SCAN
from mapmaker.geometry import MapGeometry, check_nside
from mapmaker.stream_psd import highest_frequency
from mapmaker.timestreams import FocalPlane
from mapmaker.transfer_function import beam_window
from mapmaker.wind import HIGHEST_HZ, LEAST_CYCLES, MIN_SCANS
from surveysim.atmosphere.water import wettest_mm
from surveysim.atmosphere.weather import Water
from surveysim.reduction.cleaning_pipelines import needed_detectors
from surveysim.reduction.filter_checks import check_time_filters
from surveysim.reduction.scored_region import FAINTEST, padded_side
from surveysim.runtime.errors import OutOfRangeError, SceneError
from surveysim.runtime.numbers import plural
from surveysim.scene.scene import Scene
from surveysim.telescope.focal_plane import Camera
from surveysim.telescope.noise_levels import WhiteLevels, white_levels
from surveysim.telescope.scans import Scans, samples_per_scan
from surveysim.timestreams.lost_data import most_dead

MAX_REACH_RAD = math.radians(15)
MAX_SIDE_PIXELS = 16_384
MAX_DETECTOR_SAMPLES = 1e11  # an hour of 100,000 detectors at 200 Hz and more: hours of computing
MAX_SAMPLES = 1e8  # boresight samples of an observation, all in memory
MAX_SURVEY_SCANS = 2e6  # ephemerides of more scans take many minutes
MAX_COEFFICIENTS = 3e7  # coefficients of a curved sky: 2 GB of memory, minutes of computing
FEW_MODES = 64  # modes along an axis among which an empty bin is found, if there is one
MOST_BINS = 1_000_000
MAX_MODES = 10_000  # the eigenvalues of so many take some minutes a scan


def check_templates(scene: Scene, cam: Camera, scans: Scans) -> None:
    """Raise SceneError if the templates have no atmosphere to follow, or too few detectors."""
    section = scene.cleaning
    n_det = len(cam.focal_plane.x_rad)
    for key, steps in (("algorithm", section.algorithm), *(("compare", steps) for steps in section.compare)):
        _check_fits(scene, key, steps)
        _check_count(scene, steps, n_det, f"cleaning.{key}")
        samples = math.floor(scene.scan.duration_s * scene.scan.sample_rate_hz + 1e-6)
        if "pca" in steps and samples <= (needed := needed_detectors(section, "pca")):
            raise SceneError(
                f"cleaning.{key}: found 'pca' with scans of {samples} samples; {needed + 1} or more are expected, as no"
                " mode can stand out among fewer"
            )
        if "pca" in steps and min(samples, n_det) > MAX_MODES:
            raise SceneError(
                f"cleaning.{key}: found 'pca' with {n_det} detectors and scans of {samples} samples; "
                f"{MAX_MODES} or fewer of one are expected, as it takes all eigenvalues of the smaller number"
            )
        if "wind" in steps:
            _check_wind(scene, key, scans)
    check_time_filters(scene, samples_per_scan(scans))


def _check_wind(scene: Scene, key: str, scans: Scans) -> None:
    """Raise SceneError for scans that do not tell the wind."""
    if not scans.straight:
        raise SceneError(
            f"cleaning.{key}: found 'wind' with the pattern {scene.scan.pattern!r}; straight scans at constant speed,"
            " as in a raster without turnarounds, are expected: in other scans the delays of the layer change"
        )
    if scene.scan.scans < MIN_SCANS:
        raise SceneError(
            f"cleaning.{key}: found 'wind' with {scene.scan.scans} scans; {MIN_SCANS} or more are expected to measure"
            " it"
        )
    cycles = scene.scan.duration_s * HIGHEST_HZ
    if cycles < LEAST_CYCLES or scene.scan.sample_rate_hz <= 2 * HIGHEST_HZ:
        raise SceneError(
            f"cleaning.{key}: found 'wind' with scans of {scene.scan.duration_s:g} s at"
            f" {scene.scan.sample_rate_hz:g} Hz; {LEAST_CYCLES / HIGHEST_HZ:g} s or more at more than"
            f" {2 * HIGHEST_HZ:g} Hz are expected to measure it"
        )


def _check_fits(scene: Scene, key: str, steps: tuple[str, ...]) -> None:
    """Raise SceneError for a cleaning without a layer, on which a fit calibrates the detectors."""
    found = repr(steps[0]) if len(steps) == 1 else list(steps)
    if scene.turbulent or {*steps} <= {"none", *TIME_FILTERS}:
        return
    if scene.atmosphere is None:
        raise SceneError(f"cleaning.{key}: found {found} without [atmosphere]; 'none' is expected")
    if scene.cleaning.responsivities in (SCAN, OBSERVATION) and not set(TEMPLATE_CLEANINGS).isdisjoint(steps):
        raise SceneError(
            f"cleaning.responsivities: found {scene.cleaning.responsivities!r} with {found} and no turbulence;"
            " 'known' or 'survey' is expected, as there is nothing to fit them on"
        )


def check_dead_time(scene: Scene, cam: Camera) -> None:
    """Raise SceneError if fewer detectors may be left in an observation than cleaning needs."""
    if scene.dead_time is None:
        return
    steps = {name for steps in (scene.cleaning.algorithm, *scene.cleaning.compare) for name in steps}
    left = cam.n_det - most_dead(scene.dead_time.detectors, cam.n_det)
    needed = max(needed_detectors(scene.cleaning, name) for name in steps)
    if left < needed:
        raise SceneError(
            f"dead_time.detectors: found {scene.dead_time.detectors:g}, which may leave {left} of {cam.n_det}"
            f" detectors; {needed} or more are expected for the cleaning"
        )


def check_bands(scene: Scene, cameras: Mapping[str, Camera]) -> None:
    """Raise SceneError for a cleaning that subtracts other bands, without bands of the same pixels."""
    if "spectral" not in scene.cleaning.named:
        return
    if not scene.others:
        raise SceneError("cleaning.algorithm: found 'spectral'; it needs tables [bands.NAME] of the same pixels")
    plane = cameras[scene.band_name].focal_plane
    for other in scene.others:
        found = cameras[other.band_name].focal_plane
        if not _is_one_place(plane, found):
            raise SceneError(
                f"cleaning.algorithm: found 'spectral' with {len(plane.x_rad)} detectors in band {scene.band_name} and"
                f" {len(found.x_rad)} in {other.band_name}; the same positions in all bands are expected"
            )


def _is_one_place(plane: FocalPlane, other: FocalPlane) -> bool:
    """Return whether detectors of two bands are at the same positions, to 1e-6 of the extent."""
    here, there = (np.stack([item.x_rad, item.y_rad]) for item in (plane, other))
    return here.shape == there.shape and bool(np.abs(here - there).max() <= 1e-6 * np.abs(here).max())


def check_size(scene: Scene, n_det: int, extent_rad: float) -> None:
    """Raise SceneError for a map too large for the tangent plane, or for arrays that do not fit in memory.

    `extent_rad` is the largest offset of a sample from the centre of the field, along either axis.
    """
    scan = scene.scan
    if (reach_rad := math.atan(extent_rad)) > MAX_REACH_RAD:
        found = f"{math.degrees(reach_rad):.4g}" if math.isfinite(extent_rad) else "90 or more"
        raise SceneError(
            f"scan: found a map that reaches {found} deg from its centre with this scan, "
            f"dither and camera; {math.degrees(MAX_REACH_RAD):g} deg or less is expected"
        )
    side = 2 * extent_rad / scene.map.pixel_rad
    if side > MAX_SIDE_PIXELS:
        raise SceneError(f"map.pixel: found a map of {side:.4g} pixels a side; {MAX_SIDE_PIXELS} or less are expected")
    samples = n_det * scan.scans * scan.scan_s * scan.sample_rate_hz
    if samples > MAX_DETECTOR_SAMPLES:
        raise SceneError(
            f"scan.sample_rate: found {samples:.3g} detector-samples an observation; "
            f"{MAX_DETECTOR_SAMPLES:g} or less are expected"
        )
    boresight = scan.scans * scan.scan_s * scan.sample_rate_hz
    if boresight > MAX_SAMPLES:
        raise SceneError(
            f"scan.sample_rate: found {boresight:.3g} samples an observation; {MAX_SAMPLES:g} or less are expected"
        )
    if scene.observations * scan.scans > MAX_SURVEY_SCANS:
        raise SceneError(
            f"observations: found {scene.observations * scan.scans:.3g} scans in all; "
            f"{MAX_SURVEY_SCANS:g} or less are expected"
        )


def check_levels(scene: Scene, water: Water | None, lowest_rad: float) -> WhiteLevels:
    """Return the noise in the wettest weather at the lowest elevation; raises OutOfRangeError if it is not finite."""
    most_mm = wettest_mm(scene.atmosphere) if water else math.nan
    return white_levels(scene, water.opacity if water else None, most_mm, lowest_rad)


def check_excess(scene: Scene) -> None:
    """Raise SceneError if a scan is too short for the band of the low-frequency noise."""
    if scene.excess and scene.excess.band_limit_hz * scene.scan.duration_s <= 1:
        raise SceneError(
            f"excess.band_limit: found {scene.excess.band_limit_hz:g} Hz; "
            f"more than 1 / {scene.scan.duration_key} = {1 / scene.scan.duration_s:g} Hz is expected"
        )


def check_masked(scene: Scene, masked: np.ndarray) -> None:
    """Raise SceneError if the mask leaves too few detectors for the templates."""
    _check_count(scene, scene.cleaning.algorithm, len(masked), "score.mask_separation_f_lambda")


def _check_count(scene: Scene, steps: tuple[str, ...], n_det: int, key: str) -> None:
    for name in steps:
        needed = needed_detectors(scene.cleaning, name)
        if n_det < needed:
            raise SceneError(f"{key}: found {plural(n_det, 'detector')}; {name!r} needs {needed} or more")


def check_score(scene: Scene, geometry: MapGeometry, scans: Scans) -> None:
    """Raise SceneError if the map or the sample rate is not sufficient for the score."""
    if scene.score is None:
        return
    extent = geometry.n_x * geometry.pixel_rad
    if scene.score.size_rad > extent:
        found, allowed = (math.degrees(x) * 60 for x in (scene.score.size_rad, extent))
        raise SceneError(f"score.size: found {found:.4g} arcmin; the map's {allowed:.4g} arcmin or less is expected")
    nyquist = math.pi / geometry.pixel_rad
    if scene.score.ell_max > nyquist:
        raise SceneError(
            f"score.ell_max: found {scene.score.ell_max}; the map pixel's {nyquist:.0f} or less is expected"
        )
    check_bins(scene, geometry)
    highest = highest_frequency(samples_per_scan(scans), scans.sample_rate_hz)
    if scene.score.white_noise_above_hz >= highest:
        raise SceneError(
            f"score.white_noise_above: found {scene.score.white_noise_above_hz:g} Hz; "
            f"less than {highest:.4g} Hz, the highest frequency of a scan, is expected"
        )


def check_healpix(scene: Scene) -> None:
    """Raise SceneError for HEALPix pixels so small that map pixels leave gaps between them."""
    if scene.map.healpix_nside is not None:
        try:
            check_nside("map.healpix_nside", scene.map.healpix_nside, scene.map.pixel_rad)
        except OutOfRangeError as error:
            raise SceneError(str(error)) from None


def check_bins(scene: Scene, geometry: MapGeometry) -> None:
    """Raise SceneError if no bin is scored, a bin has no Fourier mode, or the beam suppresses all of them.

    Modes have unit steps along both axes. The radii 1 and sqrt(2) are 0.41 steps apart, and beyond 64 steps
    neighbouring radii differ by at most 0.2: if all bins up to there have modes, all bins have.
    """
    score, pixel = scene.score, geometry.pixel_rad
    step = 2 * math.pi / (padded_side(score.size_rad, geometry) * pixel)
    last = max(score.ell_max, score.ell_min + score.ell_bin)
    n_bin = min(last // score.ell_bin, max(2, math.ceil(FEW_MODES * step / score.ell_bin)), MOST_BINS)
    few = np.arange(FEW_MODES + 2)
    radius = np.unique(np.hypot(few[:, None], few)) * step
    held = np.unique((radius // score.ell_bin).astype(int))
    missing = np.setdiff1d(np.arange(n_bin), held)
    if len(missing):
        first = int(missing[0]) * score.ell_bin
        raise SceneError(
            f"score.ell_bin: no Fourier mode of the map has {first} <= ell < {first + score.ell_bin}; wider bins or a"
            " larger map are expected"
        )
    lowest = -(-score.ell_min // score.ell_bin) * score.ell_bin
    if lowest + score.ell_bin > score.ell_max:
        raise SceneError(f"score.ell_bin: found {score.ell_bin}; a bin within ell_min to ell_max is expected")
    ell = np.array([min(score.ell_min + step, score.ell_max)])
    if not (flat_spectrum_psd(ell) * beam_window(ell, scene.instrument.beam_fwhm_rad))[0] > FAINTEST:
        raise SceneError(f"score.ell_min: found {score.ell_min}; multipoles that the beam lets through are expected")


def check_sky(scene: Scene, geometry: MapGeometry) -> None:
    """Raise SceneError for a curved sky that ends below the scored multipoles, or that is too large to compute.

    The taper mixes multipoles within twice its resolution: without a margin above the last bin, more than 1 % of its
    power would be missing.
    """
    if scene.sky is None or scene.sky.curved_lmax is None:
        return
    lmax, score = scene.sky.curved_lmax, scene.score
    if score is not None:
        needed = math.ceil(score.ell_max + 4 * math.pi / score.size_rad)
        if lmax < needed:
            raise SceneError(
                f"sky.curved_lmax: found {lmax}; {needed} or more is expected, which holds what the score's multipoles "
                f"up to {score.ell_max} take in through its taper"
            )
    coefficients = sky_coefficients(lmax, geometry)
    if coefficients > MAX_COEFFICIENTS:
        raise SceneError(
            f"sky.curved_lmax: found {lmax}, which takes {coefficients:.2g} coefficients for a field of this size; "
            f"{MAX_COEFFICIENTS:.0e} or fewer are expected"
        )


def sky_coefficients(lmax: int, geometry: MapGeometry) -> int:
    """Count the spherical-harmonic coefficients up to a multipole, for the orders that reach a field."""
    from surveysim.timestreams.sky_maps import highest_order

    return (lmax + 1) * (highest_order(geometry, lmax) + 1)
