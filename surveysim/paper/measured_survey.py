"""The observations that tables and figures are made of: whole surveys, measured and fitted."""

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
from surveysim.telescope.pixel_coherence import mutual_coherence

KNOWN = 0.3  # largest relative error of a speed that is used


@dataclass(frozen=True)
class MeasuredSurvey:
    """All observations of one band, of scenes that share their camera.

    `setup` of the first scene; `scene_of` (n_obs,) each observation's scene; `fits` on `grid` with the measured
    wind, or the scene's median one where none is known, None where an observation can't be fitted; `overlap`
    (n_bin,) coherence of pixels of each separation, None where no noise is shared through it.
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
        """Centre of the band, in whole GHz."""
        return round(self.setup.scene.instrument.frequency_hz / 1e9)

    @property
    def fixed(self) -> tuple[int, int]:
        """The grid point (i_b, i_h) at which the paper fits B2: 11/3 and the scene's layer height."""
        height = self.setup.scene.atmosphere.layer_height_m
        return KOLMOGOROV, int(np.argmin(np.abs(self.grid.height_m - height)))

    def theory(self, k: int) -> np.ndarray:
        """C(theta) of an observation at every grid point, with its measured wind, (n_b, n_h, n_bin)."""
        return self.grid.correlation(self.measurements[k].track_rad, self.measurements[k].elevation_rad)

    @cached_property
    def b2_drawn(self) -> np.ndarray:
        """B2 that the weather had, (n_obs,)."""
        return np.array([item.truth.b2 for item in self.measurements])

    @cached_property
    def b2_fitted(self) -> np.ndarray:
        """B2 at the fixed grid point, (n_obs,), NaN without a fit."""
        return self.b2_at(self.fixed)

    def b2_at(self, point: tuple[int, int]) -> np.ndarray:
        """B2 fitted at a grid point, (n_obs,), NaN without a fit."""
        return np.array([np.nan if fit is None else fit.b2[point] for fit in self.fits])

    @cached_property
    def pwv_mm(self) -> np.ndarray:
        """Water column drawn, (n_obs,), NaN without a site."""
        return np.array([item.truth.pwv_mm for item in self.measurements])

    @cached_property
    def wind_arcmin_s(self) -> np.ndarray:
        """Measured wind speed, (n_obs,), NaN where none was found."""
        return np.array([degrees(item.wind.speed_rad_s) * 60 for item in self.measurements])

    @cached_property
    def wind_drawn_arcmin_s(self) -> np.ndarray:
        """Wind speed that the weather had, (n_obs,)."""
        return np.array([degrees(item.truth.wind_speed_rad_s) * 60 for item in self.measurements])

    @cached_property
    def wind_good(self) -> np.ndarray:
        """Which measured winds are to be trusted, (n_obs,) bool."""
        return np.array([item.wind.flag == "" for item in self.measurements])

    @cached_property
    def wind_known(self) -> np.ndarray:
        """Which observations are fitted with their own wind, (n_obs,) bool."""
        return np.array([knows_wind(item) for item in self.measurements])


def measure_survey(scenes: list[Scene], engine: Engine, progress: Callable[[], None] = lambda: None) -> MeasuredSurvey:
    """Simulate, measure and fit every observation of scenes that share a camera; `progress` is called after each.

    Raises SceneError for a scene that can't be run, SceneError for one without an atmosphere.
    """
    # No score: no map is co-added here, and no window sky needed.
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
    bins, air = camera_pairs(setup), scenes[0].atmosphere
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
    wind, seconds = air.wind_median_rad_s, scenes[0].scan.duration_s
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
    return MeasuredSurvey(setup, tuple(names), tuple(measurements), bins, grid, overlap, fits)


def shared_overlap(setup: Setup, bins: PairBins) -> np.ndarray | None:
    """Coherence (n_bin,) of pixels of each separation; None where it shares no low-frequency noise between them."""
    excess = setup.scene.excess
    if excess is None or excess.coherence == "none":
        return None
    gamma = mutual_coherence(bins.separation_rad / setup.camera.f_lambda_rad)
    return bins.mean(gamma if excess.coherence == "field" else gamma**2)


def knows_wind(item: Measurement) -> bool:
    """Whether an observation's wind speed is known well enough to say how far the layer moves."""
    return item.wind.speed_error_rad_s < KNOWN * item.wind.speed_rad_s


def known_track(item: Measurement, usual_rad_s: float, scan_s: float) -> np.ndarray:
    """How far the layer moves during each scan (n_scan,) [rad]: by the measured wind, or a usual one.

    B2 goes as the wind's power -5/3, so a speed known to 30 % is better than none, flagged or not.
    """
    if knows_wind(item):
        return item.track_rad
    return np.full(len(item.track_rad), usual_rad_s * scan_s)
