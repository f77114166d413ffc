"""Measured surveys: all observations of one band, measured and fitted for tables and figures."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import degrees

import numpy as np

from mapmaker.correlations import PairBins
from surveysim.atmosphere.detector_correlation import CorrelationGrid, correlation_grid
from surveysim.atmosphere.turbulence_fit import (
    HEIGHT_GRID_M,
    INDEX_GRID,
    KOLMOGOROV,
    TRACKS_RAD,
    TurbulenceFit,
    fit_turbulence,
)
from surveysim.paper.measurement import Measurement, MeasurementJob, camera_pairs
from surveysim.reduction.setup import Setup, prepare
from surveysim.runtime.engine import Engine, ordered_map
from surveysim.runtime.errors import SceneError
from surveysim.scene.scene import Scene
from surveysim.telescope.illumination import UNIFORM

KNOWN = 0.3  # largest relative error of a wind speed that is used


@dataclass(frozen=True)
class MeasuredSurvey:
    """All observations of one band, from scenes with the same camera.

    Attributes
    ----------
    setup
        Prepared first scene.
    scene_of
        Name of the scene of each observation, (n_obs,).
    fits
        Turbulence fits on `grid`, with the measured wind or the median wind of the scene; None without a fit.
    overlap
        Coherence of pixels at each separation, (n_bin,); None if no low-frequency noise is correlated by overlap.
    """

    setup: Setup
    scene_of: tuple[str, ...]
    measurements: tuple[Measurement, ...]
    bins: PairBins
    grid: CorrelationGrid
    overlap: np.ndarray | None
    fits: tuple[TurbulenceFit | None, ...]

    @property
    def band_ghz(self) -> int:
        """Centre frequency of the band in whole GHz."""
        return round(self.setup.scene.instrument.band.centre_hz / 1e9)

    @property
    def fixed(self) -> tuple[int, int]:
        """Grid point (i_b, i_h) at which B2 is fitted: index 11/3 and the layer height of the scene."""
        height = self.setup.scene.atmosphere.layer_height_m
        return KOLMOGOROV, int(np.argmin(np.abs(self.grid.height_m - height)))

    def theory(self, k: int) -> np.ndarray:
        """Model C(theta) of an observation at every grid point, with its wind, (n_b, n_h, n_bin)."""
        return self.grid.correlation(self.measurements[k].track_rad, self.measurements[k].elevation_rad)

    @cached_property
    def b2_drawn(self) -> np.ndarray:
        """Drawn B2 of the layer at the elevation of each observation, (n_obs,)."""
        return np.array([item.layer_b2 for item in self.measurements])

    @cached_property
    def b2_fitted(self) -> np.ndarray:
        """Fitted B2 at the grid point `fixed`, (n_obs,); NaN without a fit."""
        return self.b2_at(self.fixed)

    def b2_at(self, point: tuple[int, int]) -> np.ndarray:
        """Fitted B2 at a grid point, (n_obs,); NaN without a fit."""
        return np.array([np.nan if fit is None else fit.b2[point] for fit in self.fits])

    @cached_property
    def pwv_mm(self) -> np.ndarray:
        """Drawn precipitable water vapour, (n_obs,); NaN without a site."""
        return np.array([item.truth.pwv_mm for item in self.measurements])

    @cached_property
    def wind_arcmin_s(self) -> np.ndarray:
        """Measured wind speed, (n_obs,); NaN without a measurement."""
        return np.array([degrees(item.wind.speed_rad_s) * 60 for item in self.measurements])

    @cached_property
    def wind_drawn_arcmin_s(self) -> np.ndarray:
        """Drawn wind speed, (n_obs,)."""
        return np.array([degrees(item.truth.wind_speed_rad_s) * 60 for item in self.measurements])

    @cached_property
    def wind_good(self) -> np.ndarray:
        """Observations with a trusted wind, without flag, (n_obs,) bool."""
        return np.array([item.wind.flag == "" for item in self.measurements])

    @cached_property
    def wind_known(self) -> np.ndarray:
        """Observations that are fitted with their measured wind, (n_obs,) bool."""
        return np.array([knows_wind(item) for item in self.measurements])


def measure_survey(scenes: list[Scene], engine: Engine, progress: Callable[[], None] = lambda: None) -> MeasuredSurvey:
    """Simulate, measure and fit every observation of scenes with the same camera.

    Parameters
    ----------
    scenes
        Scenes of one band.
    engine
        Workers.
    progress
        Called after each observation.

    Raises
    ------
    SceneError
        For a scene that can't be run or has no [atmosphere].
    """
    # No score: no map is co-added here, and no signal simulation needed.
    scenes = [scene.model_copy(update={"score": None}) for scene in scenes]
    setup = prepare(scenes[0])
    measurements, names = [], []
    for scene in scenes:
        if scene.atmosphere is None:
            raise SceneError(f"scene {scene.name!r} has no [atmosphere]; one is expected to measure it")
        for item in ordered_map(MeasurementJob(scene), range(scene.observations), engine):
            measurements.append(item)
            names.append(scene.name)
            progress()
    return fit_survey(setup, tuple(names), tuple(measurements))


def fit_survey(setup: Setup, scene_of: tuple[str, ...], measurements: tuple[Measurement, ...]) -> MeasuredSurvey:
    """Fit the turbulence of measured observations (n_obs,) of the scenes named `scene_of`; `setup` is the first."""
    bins, air = camera_pairs(setup), setup.scene.atmosphere
    grid = correlation_grid(
        bins.theta_rad,
        index=INDEX_GRID,
        height_m=HEIGHT_GRID_M,
        aperture_m=air.illuminated_aperture_m,
        outer_scale_m=air.outer_scale_m,
        track_rad=TRACKS_RAD,
        lowest_rad=min(float(item.elevation_rad.min()) for item in measurements),
    )
    overlap = shared_overlap(setup, bins)
    wind, seconds = air.wind_median_rad_s, setup.scene.scan.duration_s
    fits = tuple(
        fit_turbulence(
            item.profile,
            bins,
            grid,
            track_rad=known_track(item, wind, seconds),
            elevation_rad=item.elevation_rad,
            overlap=overlap,
        )
        for item in measurements
    )
    return MeasuredSurvey(setup, scene_of, measurements, bins, grid, overlap, fits)


def shared_overlap(setup: Setup, bins: PairBins) -> np.ndarray | None:
    """Coherence (n_bin,) of pixels at each separation; None if no low-frequency noise is correlated by overlap."""
    excess = setup.scene.excess
    if excess is None or excess.coherence == "none":
        return None
    gamma = UNIFORM.aperture(bins.separation_rad / setup.camera.f_lambda_rad)
    return bins.mean(gamma if excess.coherence == "field" else gamma**2)


def knows_wind(item: Measurement) -> bool:
    """Return whether the measured wind speed is accurate enough for the track of the layer."""
    return item.wind.speed_error_rad_s < KNOWN * item.wind.speed_rad_s


def known_track(item: Measurement, usual_rad_s: float, scan_s: float) -> np.ndarray:
    """Track of the layer during each scan (n_scan,) [rad], from the measured wind or else the median wind.

    Fitted B2 is proportional to the wind speed to the power -5/3, so a speed with an error of 30 % is better than the
    median, even with a flag.
    """
    if knows_wind(item):
        return item.track_rad
    return np.full(len(item.track_rad), usual_rad_s * scan_s)
