"""Observing conditions that a noise forecast depends on.

They are noise levels, detector correlations, the array's angle, the motion of the layer against the scan, the modes in
time that responsivity fits remove, and hit counts. Expectations over the weather are means over rank-one lattices with
random shifts (Roberts 2018); the scatter over the shifts is their error.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from itertools import chain
from typing import NamedTuple

import numpy as np

from surveysim.atmosphere.dated_weather import DatedWeather
from surveysim.atmosphere.layers import Layer
from surveysim.atmosphere.weather import Water, Weather, draw_weather, slant_b2
from surveysim.forecasting.fitted_modes import NO_FITTED_MODES, FittedModes, template_modes
from surveysim.forecasting.mode_response import ProjectedArray, layer_waves
from surveysim.forecasting.time_filters import ScanFilters
from surveysim.forecasting.track_motions import track_motions
from surveysim.reduction.cleaning_pipelines import CleaningPipeline
from surveysim.reduction.setup import Setup
from surveysim.runtime.once import keep_last
from surveysim.runtime.rng import RandomPurpose, generator
from surveysim.scene.atmosphere import Atmosphere
from surveysim.telescope.lattice_noise import LatticePixels, NoiseCorrelation, WaferPixels
from surveysim.telescope.noise_levels import white_levels
from surveysim.telescope.optics import site_load_k
from surveysim.telescope.pixel_coherence import MOST_DENSE, DensePixels
from surveysim.telescope.scans import samples_per_scan
from surveysim.timestreams.low_frequency import excess_variance, excess_variances
from surveysim.timestreams.observed_block import observation_levels, observation_weather
from surveysim.timestreams.responsivity import load_losses
from surveysim.timestreams.simulation import (
    CameraSetup,
    ObservingSetup,
    camera_white,
    drawn_offsets,
)

_NUMBERS = 5  # random numbers of a draw: four of the weather, one for the observation
_SHIFTS = 8  # random shifts of the lattice of draws; their scatter is the error of the mean
_DRAWS_A_SHIFT = 256
_DRIFT_NODES = np.sqrt(1.5) * np.arange(-1, 2)  # of equal weight, with the variance of a normal deviate

Correlation = np.ndarray | NoiseCorrelation | None  # between detectors; None for independent ones
NoiseCorrelations = tuple[list[Correlation], Correlation]
Draw = tuple[int, Weather | None]  # number of the observation, and its weather


@dataclass(frozen=True)
class ObservingConditions:
    """Observing conditions of some draws of observation and weather.

    Attributes
    ----------
    white, shared : (n_draw,)
        PSDs of independent and of shared photon and detector noise [mK^2/Hz].
    detector : (n_draw,)
        PSD of the detector noise, which is part of `white` [mK^2/Hz].
    stop_share : (n_draw,)
        The stop's part of the light that detectors share.
    excess : (n_draw,)
        Variance of the excess noise [mK^2].
    layers : (n_layer, n_draw)
        Amplitude B2 sin(el)^(1 - b) of each layer, with its share of the B2 of `slant_b2`.
    sine : (n_draw,)
        Sine of the elevation.
    angle : (n_draw, n_speed, n_direction)
        Position angle of the array from the line of motion [rad].
    motions : (n_draw, n_speed, n_motion) for each layer
        Complex velocities against the layer in the frame of the boresight's motion, of equal weight at each of its
        speeds [rad/s].
    speed_share : (n_draw, n_speed)
        Weight of each node of speed; they sum to 1.
    winds_rad_s : (n_layer, n_draw)
        Speed of each layer.
    load_k : (n_draw,)
        Load beyond that at calibration, by the elevation.
    gain : (n_draw,)
        Mean responsivity of the detectors at that load.
    """

    white: np.ndarray
    shared: np.ndarray
    detector: np.ndarray
    stop_share: np.ndarray
    excess: np.ndarray
    layers: np.ndarray
    sine: np.ndarray
    angle: np.ndarray
    motions: tuple[np.ndarray, ...]
    speed_share: np.ndarray
    winds_rad_s: np.ndarray
    load_k: np.ndarray
    gain: np.ndarray

    def some(self, draws: slice) -> "ObservingConditions":
        """Select draws."""
        by_layer = {name: getattr(self, name)[:, draws] for name in ("layers", "winds_rad_s")}
        motions = tuple(item[draws] for item in self.motions)
        others = {item.name: getattr(self, item.name)[draws] for item in fields(self) if item.name not in _BY_LAYER}
        return ObservingConditions(**others, **by_layer, motions=motions)


_BY_LAYER = ("layers", "winds_rad_s", "motions")


class _ObservationGeometry(NamedTuple):
    """Pointing of observations (n,): elevation of each scan (n, n_scan) and mean, parallactic and array angle."""

    scan_elevation_rad: np.ndarray
    elevation_rad: np.ndarray
    parallactic_rad: np.ndarray
    array_angle_rad: np.ndarray


def survey_draws(setup: Setup, first: int, end: int) -> list[Draw]:
    """Draws of observations `first` to `end - 1` in the weather of the scene's seed."""
    return [(number, observation_weather(setup, number)) for number in range(first, end)]


def population_draws(setup: Setup) -> list[list[Draw]]:
    """Draws of observations and weather that sample their whole distribution evenly.

    Returns
    -------
    list of lists of (int, Weather or None)
        Each list is a rank-one lattice in all random numbers of the weather with its own random shift. The mean over a
        list is unbiased, with an error far below that of as many independent draws.
    """
    scene, air = setup.scene, setup.air
    found = _population(scene.atmosphere, air.water, scene.seed, scene.observations, dated=air.dated)
    return [list(draws) for draws in found]


@lru_cache(maxsize=2)  # points of a sweep have weather in common
def _population(
    air: Atmosphere | None, water: Water | None, seed: int, n_obs: int, *, dated: DatedWeather | None
) -> tuple[tuple[Draw, ...], ...]:
    rng = generator(seed, RandomPurpose.WEATHER, realization=1)  # the survey is realization 0
    lists = []
    for shift in rng.random((_SHIFTS, _NUMBERS)):
        points = (shift + np.outer(np.arange(_DRAWS_A_SHIFT), _lattice_steps())) % 1
        numbers = np.minimum((points[:, -1] * n_obs).astype(int), n_obs - 1)
        draws = map(_QuasiRandomDraws, points[:, :-1])
        dates = (dated.of(number) if dated else () for number in numbers)
        weather = [
            draw_weather(air, water, numbers_of, *date) if air else None
            for numbers_of, date in zip(draws, dates, strict=True)
        ]
        lists.append(tuple(zip(numbers.tolist(), weather, strict=True)))
    return tuple(lists)


def _lattice_steps() -> np.ndarray:
    """Generating vector: powers of the inverse root of x^(d + 1) = x + 1 (Roberts 2018)."""
    root = 2.0
    for _ in range(60):
        root = (1 + root) ** (1 / (_NUMBERS + 1))
    return root ** -np.arange(1.0, _NUMBERS + 1)


class _QuasiRandomDraws:
    """Generator interface to given uniform numbers, each used once."""

    def __init__(self, uniform: np.ndarray):
        self._left = iter(np.clip(uniform, 1e-12, 1 - 1e-12).tolist())

    def standard_normal(self, size: int) -> np.ndarray:
        from scipy.special import ndtri

        return ndtri([next(self._left) for _ in range(size)])

    def uniform(self, low: float, high: float) -> float:
        return low + (high - low) * next(self._left)

    def random(self) -> float:
        return next(self._left)


@keep_last(1)
def population_conditions(setup: Setup) -> tuple[ObservingConditions, int]:
    """Observing conditions of all `population_draws`, list after list, and the number of lists."""
    lists = population_draws(setup)
    return observing_conditions(setup, chain.from_iterable(lists)), len(lists)


def observing_conditions(setup: Setup, draws: Iterable[Draw]) -> ObservingConditions:
    """Compute the observing conditions of some draws."""
    numbers, weather = zip(*draws, strict=True)
    scan_elevation, elevation, parallactic, array_angle = _geometry(setup.observing, np.array(numbers))
    unshared, shared, detector, stop = _white_noise(setup, elevation, weather)
    load_k, air = _load_changes(setup, elevation, weather), setup.air
    tracks = track_motions(setup)
    track = tracks.track_of[list(numbers)]
    turn = tracks.turn_rad[track]
    b2 = np.array([0.0 if item is None else item.b2 for item in weather])
    at_slant = slant_b2(air.water, weather, elevation) if air.layers else b2
    winds = np.reshape([_sky_wind(layer, weather, parallactic) for layer in air.layers], (-1, len(weather)))
    return ObservingConditions(
        white=unshared,
        shared=shared,
        detector=detector,
        stop_share=stop,
        excess=_excess(setup, b2),
        layers=np.reshape(
            [at_slant * _slant_factor(layer, scan_elevation) for layer in air.layers], (-1, len(weather))
        ),
        sine=np.sin(elevation),
        # A backward scan is a forward scan in a frame rotated by half a turn, with the conjugate response.
        angle=array_angle[:, None, None] + np.mod(turn, np.pi),
        motions=tuple(
            _drifted(layer, tracks.speed_rad_s[:, None], wind[:, None, None] * np.exp(-1j * turn))
            for layer, wind in zip(air.layers, winds, strict=True)
        ),
        speed_share=tracks.share[track],
        winds_rad_s=np.abs(winds),
        load_k=load_k,
        gain=_gains(setup, load_k),
    )


def _slant_factor(layer: Layer, elevation_rad: np.ndarray) -> np.ndarray:
    """Amplitude (n_draw,) of a layer over B2, as a mean over scans at some elevations (n_draw, n_scan)."""
    index = layer.section.spectral_index
    return layer.b2_factor * np.mean(np.sin(elevation_rad) ** (1 - index), axis=1)


def _sky_wind(layer: Layer, weather: Sequence[Weather], parallactic_rad: np.ndarray) -> np.ndarray:
    """Complex velocity (n_draw,) of a layer along xi and eta, from that in azimuth and elevation."""
    speed, angle = np.array([layer.wind(item) for item in weather]).T
    return np.exp(-1j * parallactic_rad) * speed * (-np.cos(angle) + 1j * np.sin(angle))


def _drifted(layer: Layer, speed_rad_s: np.ndarray, wind_rad_s: np.ndarray) -> np.ndarray:
    """Motions (..., n_motion) against a layer with a wind (..., n_direction), at nodes of its drift."""
    drift = layer.section.wind_drift
    if drift is None:
        return speed_rad_s - wind_rad_s
    faster, turned = np.meshgrid(drift.speed_rms * _DRIFT_NODES, drift.direction_rms_rad * _DRIFT_NODES)
    changed = wind_rad_s[..., None] * np.exp(faster + 1j * turned).ravel()
    return speed_rad_s - changed.reshape(*wind_rad_s.shape[:-1], -1)


def _load_changes(setup: Setup, elevation_rad: np.ndarray, weather: Sequence[Weather | None]) -> np.ndarray:
    """Load (n_draw,) [K] of the site's air beyond that at calibration; 0 where each observation is calibrated."""
    section, water = setup.scene.responsivity_drift, setup.air.water
    if section is None or section.calibration_elevation_rad is None or water is None:
        return np.zeros(len(weather))
    places = np.column_stack([elevation_rad, np.full(len(weather), section.calibration_elevation_rad)])
    loads = [site_load_k(water.opacity, item.pwv_mm, pair) for item, pair in zip(weather, places, strict=True)]
    return np.array(loads) @ [1, -1]


def _gains(setup: Setup, load_k: np.ndarray) -> np.ndarray:
    """Mean responsivities (n_draw,) at some loads."""
    if setup.scene.responsivity_drift is None:
        return np.ones(len(load_k))
    return 1 - load_losses(setup.scene, setup.camera.n_det).mean() * load_k


def _excess(setup: Setup, b2: np.ndarray) -> np.ndarray:
    """Variances (n_draw,) of the excess noise."""
    section = setup.scene.excess
    if section is None:
        return np.zeros(len(b2))
    if setup.scene.atmosphere is None:
        return np.full(len(b2), excess_variance(section, None))
    return excess_variances(section, b2)


def _white_noise(setup: Setup, elevation_rad: np.ndarray, weather: Sequence[Weather | None]) -> np.ndarray:
    """White noise of independent and shared origin, and of detectors [mK^2/Hz], and the stop's part, (4, n_draw)."""
    if not setup.scene.given_by_power:  # the same in all observations
        return np.repeat([_white_of(setup, np.nan, np.nan)], len(weather), axis=0).T
    pwv = [np.nan if item is None else item.pwv_mm for item in weather]
    return np.array([_white_of(setup, *item) for item in zip(pwv, elevation_rad.tolist(), strict=True)]).T


def _white_of(setup: Setup, pwv_mm: float, elevation_rad: float) -> tuple[float, float, float, float]:
    water = setup.air.water
    white = white_levels(setup.scene, water.opacity if water else None, pwv_mm, elevation_rad)
    shared = white.photon_mk2_hz * white.shared
    detector = white.detector_mk2_hz
    unshared = white.photon_mk2_hz - shared + detector
    if setup.camera.properties.white_differs:
        each = camera_white(setup.camera, white)
        shared, unshared = float(each.shared.mean()), float((each.alone + each.detector).mean())
        detector = float(each.detector.mean())
    return unshared, shared, detector, white.stop_share


def _geometry(observing: ObservingSetup, numbers: np.ndarray) -> _ObservationGeometry:
    """Pointing of the observations with some numbers (n,), which may occur more than once."""
    distinct, place = np.unique(numbers, return_inverse=True)
    elevation, parallactic = observing.angles.elevation_rad[distinct], observing.angles.parallactic_rad[distinct]
    camera_angle = np.array([drawn_offsets(observing, number)[1] for number in distinct.tolist()])
    middle = parallactic[:, parallactic.shape[1] // 2]
    found = elevation, elevation.mean(axis=1), middle, middle + camera_angle
    return _ObservationGeometry(*(item[place] for item in found))


@dataclass(frozen=True, eq=False)
class WhiteShapes:
    """White noise (n_det,) of each detector over the mean of all: shared photon noise, and independent noise."""

    shared: np.ndarray
    alone: np.ndarray


def white_shapes(setup: Setup) -> WhiteShapes | None:
    """Shapes of the white noise over the detectors, in the first observation; None where all detectors are alike.

    Only efficiencies make them depend, slightly, on the load of the observation.
    """
    if not setup.camera.properties.white_differs:
        return None
    white = camera_white(setup.camera, observation_levels(setup, 0))
    alone = white.alone + white.detector
    return WhiteShapes(*(item / item.mean() if item.any() else item for item in (white.shared, alone)))


def independent_noise(shapes: WhiteShapes | None, pipeline: CleaningPipeline) -> NoiseCorrelation | None:
    """Diagonal correlation of the independent white noise of a pipeline's detectors; None where all are alike."""
    return None if shapes is None else NoiseCorrelation(None, np.sqrt(shapes.alone[pipeline.rows]))


def noise_correlations(
    camera: CameraSetup, pipeline: CleaningPipeline, shapes: WhiteShapes | None = None
) -> NoiseCorrelations:
    """Detector correlations of the shared photon noise, by part, and of the excess noise.

    Parameters
    ----------
    shapes
        White noise of each detector; None where all are alike.

    Returns
    -------
    photon, excess
        (n_det, n_det) matrices, or `NoiseCorrelation` for large arrays; None for independent noise. Those of the photon
        noise add up with `part_weights`. `excess` includes the responsivities.
    """
    gain = camera.responsivity[pipeline.rows]
    white = np.ones(len(gain)) if shapes is None else np.sqrt(shapes.shared[pipeline.rows])
    photon = _correlations(camera.photon_correlation, pipeline, white)
    excess = _correlations(camera.excess_correlation, pipeline, gain)
    return photon, excess[0]


def _correlations(
    pixels: DensePixels | LatticePixels | WaferPixels | None, pipeline: CleaningPipeline, gain: np.ndarray
) -> list[Correlation]:
    """Parts of the correlation of a pipeline's detectors, multiplied by `gain` on both sides."""
    if pixels is None:
        return [np.diag(gain**2) if len(gain) <= MOST_DENSE else NoiseCorrelation(None, gain)]
    if isinstance(pixels, DensePixels):
        return [part * (gain[:, None] * gain) for part in pixels.columns(pipeline.rows)]
    return [NoiseCorrelation(torus, gain) for torus in pixels.columns(pipeline.rows)]


def removed_modes(
    setup: Setup,
    pipeline: CleaningPipeline,
    array: ProjectedArray,
    levels: ObservingConditions,
    filters: ScanFilters | None = None,
) -> FittedModes:
    """Find the modes in time that the responsivity fits of a pipeline remove from scans.

    They are those of layers that move at the median speeds of `levels`, after the filters before the templates.
    """
    scans = setup.observing.scans
    fits = {"scan": 1.0, "observation": 1 / scans.n_scans}
    # PCA fits a mode to each scan, even with known responsivities.
    share = fits["scan"] if pipeline.uses("pca") else fits.get(setup.scene.cleaning.responsivities, 0.0)
    if not setup.air.layers or not len(array.basis) or not share:
        return NO_FITTED_MODES
    seconds, frequencies, powers = samples_per_scan(scans) / scans.sample_rate_hz, [], []
    for layer, amplitude, motions in zip(setup.air.layers, levels.layers, levels.motions, strict=True):
        motion = np.median(np.abs(motions))
        waves = layer_waves(layer.strips.screen, motion * seconds, [np.median(levels.sine)])
        common = np.tile(array.phases(2 * np.pi * waves.half).mean(axis=0), 2)
        frequencies.append((waves.alpha * motion).real)
        powers.append(np.median(amplitude) * waves.power[0] * (common.real**2 + common.imag**2))
    waves_of_all = np.concatenate(frequencies), np.concatenate(powers)
    before = None if filters is None else filters.before
    return template_modes(*waves_of_all, seconds, before).scaled(share)
