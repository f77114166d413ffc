"""Measurements of one observation from its time-streams: wind, correlations, variances.

The drawn weather is kept for comparison only.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from typing import cast

import numpy as np
from scipy.fft import rfft

from mapmaker.binning import bin_map
from mapmaker.cleaning import Cleaned, TemplateOptions, clean
from mapmaker.cleaning.templates import AVERAGE, QUADRATIC, template_basis
from mapmaker.correlations import PairBins, Profile, correlation_profile, pair_bins, scan_covariances
from mapmaker.geometry import MapGeometry, boresight_pixels
from mapmaker.spectrum import mode_ell, mode_multiplicity, mode_psd, tukey_taper
from mapmaker.stream_psd import hann_psd, low_frequency_variance, white_level
from mapmaker.timestreams import FocalPlane, Timestreams
from mapmaker.wind import WindFit, measure_wind, scan_velocities
from surveysim.atmosphere.layers import dominant_wind
from surveysim.atmosphere.weather import Weather, slant_b2
from surveysim.reduction.setup import Setup, prepare
from surveysim.runtime.errors import InsufficientDataError
from surveysim.scene.scene import Scene
from surveysim.telescope.patterns.raster import Raster
from surveysim.telescope.pointing import Pointing
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.observation import draw_observation
from surveysim.timestreams.observed_block import observation_weather
from surveysim.timestreams.simulation import observation_path

# Multipoles, of the highest that the map's pixels hold along an axis, where no atmosphere is left in a map.
WHITE_FROM = 0.6
UNHIT_MAX = 0.01  # largest fraction of pixels without hits in a map with a variance
LOW_FREQUENCY_HZ = 1.0  # the paper's Table 2
WHITE_ABOVE_HZ = 2.5  # section 5.1
CORRELATION_EDGES = np.linspace(-1.0, 1.0, 81)  # bin edges of correlation coefficients
# Cleanings after which noise is compared between detectors (section 5.1), and their templates.
PAIR_CLEANINGS = {"average": AVERAGE, "quadratic": QUADRATIC}


@dataclass(frozen=True)
class PairNoise:
    """Low-frequency noise of detectors and pairs after one cleaning, averaged over kept scans (section 5.1).

    Attributes
    ----------
    variance_mk2, adjacent_mk2
        Mean variance of detectors and mean covariance of adjacent pairs up to 1 Hz [mK^2].
    white_mk2, adjacent_white_mk2
        White noise in the same band, from the level above 2.5 Hz [mK^2].
    adjacent_counts, distant_counts
        Histograms of correlation coefficients up to 1 Hz, (n_edge - 1,) between `CORRELATION_EDGES`.
    adjacent_correlation
        Mean correlation coefficient of adjacent pairs.
    correlation
        Mean correlation coefficient of pairs by separation, (n_bin,).
    """

    variance_mk2: float
    adjacent_mk2: float
    white_mk2: float
    adjacent_white_mk2: float
    adjacent_counts: np.ndarray
    distant_counts: np.ndarray
    adjacent_correlation: float
    correlation: np.ndarray


@dataclass(frozen=True)
class Measurement:
    """Measurements of one observation.

    Attributes
    ----------
    truth
        The drawn weather.
    layer_b2
        B2 of the layer at the elevation of the observation (`surveysim.atmosphere.weather.slant_b2`).
    wind
        Measured wind in the frame of the array.
    camera_angle_rad
        Angle of the array's x axis from the direction of increasing azimuth [rad].
    profile
        Correlation against separation.
    track_rad
        Track of the layer during each scan by the measured wind, (n_scan,) [rad].
    elevation_rad
        Elevation of each scan, (n_scan,) [rad].
    raw_mk2
        Variance of mean-removed scans below 1 Hz without white noise, mean over detectors [mK^2].
    map_mk2, map_white_mk2
        Variance of the map after average cleaning, and its white part [mK^2].
    pair_noise
        Noise of pairs by cleaning; cleanings that keep no scan or need more detectors are left out.
    """

    observation: int
    truth: Weather
    layer_b2: float
    wind: WindFit
    camera_angle_rad: float
    profile: Profile
    track_rad: np.ndarray
    elevation_rad: np.ndarray
    raw_mk2: float
    map_mk2: float
    map_white_mk2: float
    pair_noise: Mapping[str, PairNoise]


@dataclass(frozen=True)
class MeasurementJob:
    """Job of a worker: simulate and measure an observation of a scene, given its number."""

    scene: Scene

    def __call__(self, observation: int) -> Measurement:
        """Simulate and measure an observation."""
        setup = prepare(self.scene)
        streams = draw_observation(setup, observation)
        return measure(setup, streams, observation)


def measure(setup: Setup, streams: Timestreams, observation: int) -> Measurement:
    """Measure the time-streams of one observation of a scene with an atmosphere."""
    _, pointing = observation_path(setup.observing, observation)
    bounds, rate = streams.scan_bounds, setup.observing.scans.sample_rate_hz
    velocity = scan_velocities(streams)
    wind = measure_wind(streams.data_mk, bounds, streams.focal_plane, sample_rate_hz=rate, scan_velocity_rad_s=velocity)
    seconds = samples_per_scan(setup.observing.scans) / rate
    cleaned = {name: _clean(setup, streams, name) for name in supported_cleanings(setup)}
    variance, white = map_variances(setup, streams, pointing, cleaned["average"])
    bins, truth = camera_pairs(setup), dominant_wind(setup.scene.atmosphere, observation_weather(setup, observation))
    return Measurement(
        observation=observation,
        truth=truth,
        layer_b2=float(slant_b2(setup.air.water, [truth], [pointing.scan_elevation_rad.mean()])[0]),
        wind=wind,
        camera_angle_rad=pointing.camera_angle_rad,
        profile=correlation_profile(scan_covariances(streams.data_mk, bounds), bins),
        track_rad=np.hypot(*(wind.velocity_rad_s - velocity).T) * seconds,
        elevation_rad=pointing.scan_elevation_rad,
        raw_mk2=raw_variance(setup, streams),
        map_mk2=variance,
        map_white_mk2=white,
        pair_noise={name: pair_noise(item, bins, rate) for name, item in cleaned.items() if item.kept.any()},
    )


def _clean(setup: Setup, streams: Timestreams, name: str) -> Cleaned:
    section = setup.scene.cleaning
    options = TemplateOptions(section.tolerance, section.max_iterations, setup.analysis.responsivities)
    return clean(name, streams.data_mk, streams.scan_bounds, streams.focal_plane, options=options)


def camera_pairs(setup: Setup) -> PairBins:
    """Pairs of the camera's detectors by separation; errors as for `pair_bins`."""
    plane = setup.camera.focal_plane
    return _pairs(plane.x_rad.tobytes(), plane.y_rad.tobytes(), plane.fwhm_rad)


@lru_cache(maxsize=2)
def _pairs(x: bytes, y: bytes, fwhm_rad: float) -> PairBins:
    return pair_bins(FocalPlane(np.frombuffer(x), np.frombuffer(y), fwhm_rad))


def raw_variance(setup: Setup, streams: Timestreams) -> float:
    """Variance [mK^2] of mean-removed scans below 1 Hz without white noise, mean over detectors (Table 2)."""
    rate, n_scans = setup.observing.scans.sample_rate_hz, setup.observing.scans.n_scans
    low = low_frequency_variance(streams.data_mk, n_scans, rate, LOW_FREQUENCY_HZ)
    psd = hann_psd(streams.data_mk, n_scans, np.ones(n_scans, bool), rate)
    white = white_level(psd, samples_per_scan(setup.observing.scans), rate, WHITE_ABOVE_HZ)
    return float(np.mean(low - white * LOW_FREQUENCY_HZ))


def pair_noise(cleaned: Cleaned, bins: PairBins, sample_rate_hz: float) -> PairNoise:
    """Measure the noise below 1 Hz of detectors and of all their pairs, in cleaned scans of one length.

    The variance is that of `low_frequency_variance`: modes of a scan up to 1 Hz, without its mean.

    Raises
    ------
    InsufficientDataError
        If no scan is kept.
    """
    if not cleaned.kept.any():
        raise InsufficientDataError("found no scan that is kept; one or more is expected")
    n_det, n_scan = len(cleaned.data_mk), len(cleaned.kept)
    scans = cleaned.data_mk.reshape(n_det, n_scan, -1)[:, cleaned.kept]
    spectrum, n = rfft(scans, axis=-1), scans.shape[-1]
    frequency = np.arange(spectrum.shape[-1]) * (sample_rate_hz / n)
    low = (frequency > 0) & (frequency < LOW_FREQUENCY_HZ * (1 + 1e-9))
    high = (frequency > WHITE_ABOVE_HZ) & (2 * np.arange(len(frequency)) < n)
    covariance = _mode_covariance(spectrum[..., low], n)
    white = _mode_covariance(spectrum[..., high], n) * (low.sum() / high.sum())
    deviation, near = np.sqrt(np.diag(covariance)), bins.adjacent
    pairs = bins.first, bins.second
    correlation = np.clip(covariance[pairs] / (deviation[bins.first] * deviation[bins.second]), -1, 1)
    return PairNoise(
        variance_mk2=float(np.diag(covariance).mean()),
        adjacent_mk2=float(covariance[pairs][near].mean()),
        white_mk2=float(np.diag(white).mean()),
        adjacent_white_mk2=float(white[pairs][near].mean()),
        adjacent_counts=np.histogram(correlation[near], CORRELATION_EDGES)[0].astype(np.int32),
        distant_counts=np.histogram(correlation[~near], CORRELATION_EDGES)[0].astype(np.int32),
        adjacent_correlation=float(correlation[near].mean()),
        correlation=bins.mean(correlation),
    )


def _mode_covariance(modes: np.ndarray, n: int) -> np.ndarray:
    """Covariance (n_det, n_det) of some modes (n_det, n_scan, n_mode) of scans of n samples."""
    parts = np.ascontiguousarray(modes, np.complex128).reshape(len(modes), -1).view(np.float64)
    return parts @ parts.T * (2 / (n**2 * modes.shape[1]))


def supported_cleanings(setup: Setup) -> tuple[str, ...]:
    """Names of `PAIR_CLEANINGS` for which the camera has enough detectors."""
    plane = setup.camera.focal_plane
    return _supported(plane.x_rad.tobytes(), plane.y_rad.tobytes(), plane.fwhm_rad)


@lru_cache(maxsize=2)
def _supported(x: bytes, y: bytes, fwhm_rad: float) -> tuple[str, ...]:
    plane, names = FocalPlane(np.frombuffer(x), np.frombuffer(y), fwhm_rad), []
    for name, terms in PAIR_CLEANINGS.items():
        with suppress(ValueError):  # detectors too few, or on one line or conic
            template_basis(plane, terms)
            names.append(name)
    return tuple(names)


def map_variances(setup: Setup, streams: Timestreams, pointing: Pointing, cleaned: Cleaned) -> tuple[float, float]:
    """Variance of the map of cleaned time-streams, and its white part [mK^2] (section 3.5).

    The variance is taken in the middle of the map under a cosine taper; the white part is the level of the highest
    multipoles. Both are NaN for a map with gaps.
    """
    geometry, plane = setup.analysis.geometry, streams.focal_plane
    angle = pointing.array_angle_rad
    index = boresight_pixels(geometry, pointing.xi_rad, pointing.eta_rad, angle, plane=plane)
    item = bin_map(geometry, cleaned.data_mk, index, streams.scan_bounds, kept=cleaned.kept)
    raster = cast(Raster, setup.observing.scans)  # of the paper's scenes
    taper, high, share = _map_modes(geometry, raster.step_rad * (raster.n_scans - 1))
    if np.sum(taper**2 * (item.hits[0] == 0)) > UNHIT_MAX * np.sum(taper**2):
        return np.nan, np.nan  # gaps would lower the variance
    psd = mode_psd(item.signal_mk[0], taper, geometry.pixel_rad) / geometry.pixel_rad**2
    return float(np.sum(psd * share)), float(np.mean(psd[high]))


@lru_cache(maxsize=2)
def _map_modes(geometry: MapGeometry, covered_rad: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Taper (n_y, n_x) of the covered square, mask of the modes without atmosphere, and weight of each mode in a
    variance."""
    n_y, n_x = geometry.n_y, geometry.n_x
    side = min(covered_rad, n_x * geometry.pixel_rad)
    ell = mode_ell(n_y, n_x, geometry.pixel_rad)
    cells = mode_multiplicity(n_y, n_x).reshape(ell.shape)
    return (
        tukey_taper(n_y, n_x, geometry.pixel_rad, size_rad=side, edge_fraction=0.5),
        ell > WHITE_FROM * np.pi / geometry.pixel_rad,
        cells / cells.sum(),
    )
