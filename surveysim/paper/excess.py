"""Excess low-frequency noise of detectors and of adjacent pairs: what is left without atmosphere and white noise."""

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

_ELEVATIONS = 5  # between which it is cubic
_SEPARATIONS = 48  # at which the thin screen's correlation is computed; it is smooth over the array


@dataclass(frozen=True)
class ExcessNoise:
    """Excess noise up to 1 Hz of each observation after one cleaning, (n_obs,) [mK^2], NaN where it is not known.

    `covariance_mk2` of adjacent pairs, `variance_mk2` of detectors.
    """

    covariance_mk2: np.ndarray
    variance_mk2: np.ndarray

    @property
    def fraction(self) -> np.ndarray:
        """Correlation of adjacent pairs, (n_obs,); NaN where there is no excess variance."""
        positive = np.where(self.variance_mk2 > 0, self.variance_mk2, np.nan)
        return self.covariance_mk2 / positive


def excess_noise(survey: MeasuredSurvey, cleaning: str) -> ExcessNoise:
    """Low-frequency noise less white noise and residual atmosphere, as Table 2 has it.

    White noise, and what of it adjacent pairs share, is taken from above 2.5 Hz, the residual atmosphere from the
    thin screen at each observation's fitted B2. Raises ValueError for another cleaning than in `PAIR_CLEANINGS`.
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
    """What each observation's pairs have after a cleaning, None where it kept no scan."""
    return [item.pair_noise.get(cleaning) for item in survey.measurements]


def white_correlation(survey: MeasuredSurvey, cleaning: str) -> np.ndarray:
    """Correlation (n_obs,) of adjacent pairs above 2.5 Hz after a cleaning, NaN where it kept no scan."""
    items = pair_noises(survey, cleaning)
    return np.array([np.nan if item is None else item.adjacent_white_mk2 / item.white_mk2 for item in items])


def residual_atmosphere(survey: MeasuredSurvey, cleaning: str) -> np.ndarray:
    """What the thin screen leaves adjacent pairs and detectors after cleaning, (2, n_obs) [mK^2], NaN without a fit.

    At the scene's index and height and each observation's B2 and track, for known responsivities: fitting them to
    every scan takes another fifth of it. Errors as `excess_noise`.
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
    """`residual_by_track` at any elevation of a survey's observations, given by its sine."""
    from scipy.interpolate import CubicSpline

    sines = [np.sin(item.elevation_rad).mean() for item in survey.measurements]
    node = np.linspace(min(sines) - 1e-3, max(sines) + 1e-3, _ELEVATIONS)
    rows = [residual_by_track(survey.setup, cleaning, sine) for sine in node]
    return lambda sine, log_track: CubicSpline(node, [row(log_track) for row in rows])(sine)


def residual_by_track(setup: Setup, cleaning: str, sine: float) -> "CubicSpline":
    """Spline of ln track [rad]: what cleaning leaves of a unit B2, (..., 2) in adjacent pairs and detectors.

    At an elevation of this sine: ``P C P`` with P the projection that removes the templates. Raises ValueError for
    cameras that don't support them.
    """
    from scipy.interpolate import CubicSpline

    screen, plane, bins = at_elevation(setup.air.strips.screen, sine), setup.camera.focal_plane, camera_pairs(setup)
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
