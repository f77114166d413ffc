"""Excess low-frequency noise of detectors and adjacent pairs: noise beyond residual atmosphere and white noise."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mapmaker.cleaning.templates import template_basis
from surveysim.atmosphere.detector_correlation import scan_correlation
from surveysim.atmosphere.thin_screen import at_elevation
from surveysim.atmosphere.turbulence_fit import TRACKS_RAD
from surveysim.paper.measured_survey import MeasuredSurvey, known_track
from surveysim.paper.measurement import PAIR_CLEANINGS, PairNoise, camera_pairs
from surveysim.reduction.setup import Setup

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_ELEVATIONS = 5  # nodes of the cubic interpolation in elevation
_SEPARATIONS = 48  # nodes of the thin screen's correlation, which is smooth over the array


@dataclass(frozen=True)
class ExcessNoise:
    """Excess noise up to 1 Hz after one cleaning; NaN for observations without it.

    Attributes
    ----------
    covariance_mk2
        Mean covariance of adjacent pairs, (n_obs,) [mK^2].
    variance_mk2
        Mean variance of detectors, (n_obs,) [mK^2].
    """

    covariance_mk2: np.ndarray
    variance_mk2: np.ndarray

    @property
    def fraction(self) -> np.ndarray:
        """Correlation of the excess noise in adjacent pairs, (n_obs,); NaN without excess variance."""
        positive = np.where(self.variance_mk2 > 0, self.variance_mk2, np.nan)
        return self.covariance_mk2 / positive


def excess_noise(survey: MeasuredSurvey, cleaning: str) -> ExcessNoise:
    """Excess noise of Table 2: low-frequency noise minus white noise and residual atmosphere.

    White noise, and its covariance in adjacent pairs, is measured above 2.5 Hz. The residual atmosphere is computed
    from the thin screen at the fitted B2 of each observation.

    Raises
    ------
    ValueError
        For a cleaning that is not in `PAIR_CLEANINGS`.
    """
    atmosphere = residual_atmosphere(survey, cleaning)
    items = pair_noises(survey, cleaning)
    white_less = [
        (np.nan, np.nan)
        if item is None
        else (item.adjacent_mk2 - item.adjacent_white_mk2, item.variance_mk2 - item.white_mk2)
        for item in items
    ]
    return ExcessNoise(*(np.array(white_less).T - atmosphere))


def pair_noises(survey: MeasuredSurvey, cleaning: str) -> list[PairNoise | None]:
    """Noise of pairs in each observation after one cleaning; None where no scan was kept."""
    return [item.pair_noise.get(cleaning) for item in survey.measurements]


def white_correlation(survey: MeasuredSurvey, cleaning: str) -> np.ndarray:
    """Correlation (n_obs,) of adjacent pairs above 2.5 Hz after one cleaning; NaN where no scan was kept."""
    items = pair_noises(survey, cleaning)
    return np.array([np.nan if item is None else item.adjacent_white_mk2 / item.white_mk2 for item in items])


def residual_atmosphere(survey: MeasuredSurvey, cleaning: str) -> np.ndarray:
    """Residual atmosphere after cleaning, for adjacent pairs and for detectors, (2, n_obs) [mK^2]; NaN without a fit.

    It holds for the spectral index and height of the scene, the fitted B2 and track of each observation, and known
    responsivities. Responsivities fitted to each scan remove another fifth. Errors as for `excess_noise`.
    """
    if cleaning not in PAIR_CLEANINGS:
        raise ValueError(f"cleaning: found {cleaning!r}; {', '.join(PAIR_CLEANINGS)} are expected")
    air, setup = survey.setup.scene.atmosphere, survey.setup
    left = _residual_spline(survey, cleaning)
    found = np.full((2, len(survey.measurements)), np.nan)
    for k, (item, b2) in enumerate(zip(survey.measurements, survey.b2_fitted, strict=True)):
        track = known_track(item, air.wind_median_rad_s, setup.scene.scan.duration_s)
        found[:, k] = b2 * np.mean(left(np.sin(item.elevation_rad).mean(), np.log(track)), axis=0)
    return found


def _residual_spline(survey: MeasuredSurvey, cleaning: str) -> Callable[[float, np.ndarray], np.ndarray]:
    """`residual_by_track`, interpolated over the sine of the elevations of a survey."""
    from scipy.interpolate import CubicSpline

    sines = [np.sin(item.elevation_rad).mean() for item in survey.measurements]
    node = np.linspace(min(sines) - 1e-3, max(sines) + 1e-3, _ELEVATIONS)
    rows = [residual_by_track(survey.setup, cleaning, sine) for sine in node]
    return lambda sine, log_track: CubicSpline(node, [row(log_track) for row in rows])(sine)


def residual_by_track(setup: Setup, cleaning: str, sine: float) -> "CubicSpline":
    """Spline of the residual atmosphere for unit B2 against ln track [rad]: (..., 2) for adjacent pairs and detectors.

    The residual covariance is ``P C P`` with the projection P that removes the templates.

    Parameters
    ----------
    setup
        Prepared scene.
    cleaning
        A name of `PAIR_CLEANINGS`.
    sine
        Sine of the elevation.

    Raises
    ------
    InsufficientDataError
        For cameras with too few detectors for the templates.
    """
    from scipy.interpolate import CubicSpline

    screen, plane, bins = (
        at_elevation(setup.air.layers[0].strips.screen, sine),
        setup.camera.focal_plane,
        camera_pairs(setup),
    )
    basis = template_basis(plane, PAIR_CLEANINGS[cleaning])
    project = np.eye(setup.camera.n_det) - basis.T @ basis
    apart = np.hypot(*(np.subtract.outer(axis, axis) for axis in (plane.x_rad, plane.y_rad)))
    node = np.linspace(0, apart.max(), _SEPARATIONS)
    pairs = bins.first[bins.adjacent], bins.second[bins.adjacent]
    left = []
    for track in TRACKS_RAD:
        kept = project @ CubicSpline(node, scan_correlation(screen, node, track))(apart) @ project
        left.append((kept[pairs].mean(), np.diag(kept).mean()))
    return CubicSpline(np.log(TRACKS_RAD), np.array(left) * sine ** (1 - screen.index))
