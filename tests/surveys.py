"""Measured surveys made by hand: winds, fits and observations with known answers."""

import numpy as np

from mapmaker.wind import WindFit
from surveysim.atmosphere.detector_correlation import CorrelationGrid
from surveysim.atmosphere.turbulence_fit import HEIGHT_GRID_M, INDEX_GRID, KOLMOGOROV, TurbulenceFit
from surveysim.atmosphere.weather import Weather
from surveysim.paper.measured_survey import MeasuredSurvey
from surveysim.paper.measurement import Measurement, camera_pairs

ARCMIN = np.radians(1 / 60)
N_SCAN = 4
PAIR_ANGLE = np.radians(np.arange(-172.5, 180.0, 15.0))


def wind(speed_arcmin_s: float, flag: str = "", goodness: float = 1.0) -> WindFit:
    """A wind along x: its slopes are 2 pi cos(angle) / speed."""
    speed = speed_arcmin_s * ARCMIN
    slope = 2 * np.pi / speed * np.cos(PAIR_ANGLE)
    return WindFit(
        velocity_rad_s=np.array([speed, 0.0]),
        speed_rad_s=speed,
        angle_rad=0.0,
        speed_error_rad_s=0.1 * speed,
        angle_error_rad=0.1,
        pair_angle_rad=PAIR_ANGLE,
        slope=slope,
        slope_error=np.full(len(slope), 0.05 * np.abs(slope).max()),
        sinusoid=np.array([2 * np.pi / speed, 0.0]),
        goodness=goodness,
        highest_hz=1.0,
        flag=flag,
    )


def fit(b2: float, best=(KOLMOGOROV, 3), chi2: float = 1.0) -> TurbulenceFit:
    """B2 as given at 11/3 and the scene's height, nonsense elsewhere."""
    amplitudes, goodness = np.full((2, len(INDEX_GRID), len(HEIGHT_GRID_M)), 1e6)
    amplitudes[KOLMOGOROV, 3] = b2
    goodness[best] = chi2
    return TurbulenceFit(amplitudes, goodness, best)


def measured(setup, number=0, b2=280.0, pwv=1.0, left=1.0, found=None, profile=None, drawn_wind=30.0) -> Measurement:
    return Measurement(
        observation=number,
        truth=Weather(b2, drawn_wind * ARCMIN, 0.3, pwv),
        layer_b2=b2,
        wind=found or wind(30.0),
        camera_angle_rad=0.0,
        profile=profile,
        track_rad=np.full(N_SCAN, 0.1),
        elevation_rad=np.full(N_SCAN, 1.0),
        raw_mk2=1.0,
        map_mk2=2.0 + left,
        map_white_mk2=2.0,
        pair_noise={},
    )


def falls(index: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Fall of the theory of these tests with the square of separation at the zenith, (n_b, n_h) [1/arcmin^2]."""
    return 1e-5 * np.outer(8.0 - index, height_m / 1000.0)


def grid(bins) -> CorrelationGrid:
    index, height = np.array(INDEX_GRID), np.array(HEIGHT_GRID_M)
    node = np.linspace(0.0, 1.5 * bins.theta_rad.max(), 33)
    values = np.zeros((len(index), len(height), len(node) + 1))
    values[..., 1:] = np.exp(-falls(index, height)[..., None] * (node / ARCMIN) ** 2)
    return CorrelationGrid(
        index, height, bins.theta_rad, node, lambda log_track: np.repeat(values[:, :, None], len(log_track), 2)
    )


def survey(setup, items, fits, scene_of=None) -> MeasuredSurvey:
    bins = camera_pairs(setup)
    overlap = np.cos(3.0 * bins.theta_rad / ARCMIN)
    return MeasuredSurvey(
        setup, tuple(scene_of or ["small"] * len(items)), tuple(items), bins, grid(bins), overlap, fits
    )


def of_b2(setup, b2, **each) -> MeasuredSurvey:
    """A survey whose fitted B2 are those given, NaN for none; `each` has a value for every observation."""
    rows = [dict(zip(each, values, strict=True)) for values in zip(*each.values(), strict=True)] or [{}] * len(b2)
    items = [measured(setup, k, **{"b2": b2[k] if np.isfinite(b2[k]) else 1.0, **rows[k]}) for k in range(len(b2))]
    return survey(setup, items, tuple(fit(value) if np.isfinite(value) else None for value in b2))


def named(panel, label):
    return next(series for series in panel.series if label in series.label)
