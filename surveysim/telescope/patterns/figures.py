"""Patterns that are curves about the centre of the field, cut into chunks of equal duration in place of scans.

A curve has axes x and y in the tangent plane of the field: east and north, or, in the frame "horizon", along azimuth
and along the vertical through the centre of the field. The horizon's axes turn with the parallactic angle of every
sample. To first order in the offset, x is the offset in azimuth times the cosine of the elevation.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np

from surveysim.scene.scan_figures import FigureScan, LissajousFigure
from surveysim.telescope.horizon_frame import HorizonFrame, to_horizon
from surveysim.telescope.scans import ScanPath, Scans, sample_times, timing


@dataclass(frozen=True, kw_only=True)
class Figure(Scans):
    """Base of the curves.

    Attributes
    ----------
    horizon
        Whether the axes are those of the horizon.
    angle_rad, angle_step_rad
        Angle by which the first observation's curve is turned from x to y, and that between observations.
    added
        Lissajous figure that is added to the curve.
    """

    horizon: bool
    angle_rad: float
    angle_step_rad: float
    added: LissajousFigure | None

    @abstractmethod
    def curve(self, time_s: np.ndarray) -> np.ndarray:
        """Compute the offsets (2, n) along x and y [rad] at times (n,) since the start of an observation."""

    @abstractmethod
    def extent_rad(self) -> float:
        """Compute the largest offset from the centre along either axis of the sky, in any observation [rad]."""

    @abstractmethod
    def half_width_rad(self) -> float:
        """Return half the width of the area that the curve fills, where it is narrowest [rad]."""

    def box_extent_rad(self, half_x_rad: float, half_y_rad: float) -> float:
        """Compute the extent of a box about the centre, with half sides along x and y, and of what is added to it."""
        if self.added:
            half_x_rad, half_y_rad = half_x_rad + self.added.amplitude_x_rad, half_y_rad + self.added.amplitude_y_rad
        if self.horizon or self.angle_step_rad:
            return float(np.hypot(half_x_rad, half_y_rad))
        cos, sin = abs(np.cos(self.angle_rad)), abs(np.sin(self.angle_rad))
        return float(max(half_x_rad * cos + half_y_rad * sin, half_x_rad * sin + half_y_rad * cos))


def figure_keys(section: FigureScan) -> dict[str, Any]:
    """Return the arguments that figures of a section [scan] have in common."""
    return {
        **timing(section),
        "horizon": section.frame == "horizon",
        "angle_rad": section.angle_rad,
        "angle_step_rad": section.angle_step_rad,
        "added": section.lissajous,
    }


def figure_extent(figure: Figure, lowest_rad: float) -> float:
    """Compute the largest offset from the centre along either axis of the sky, at any elevation [rad]."""
    return figure.extent_rad()


def covered_width(figure: Figure) -> float:
    """Compute the width of the area that the boresight covers, where it is narrowest [rad]."""
    added = figure.added
    return 2 * (figure.half_width_rad() + (min(added.amplitude_x_rad, added.amplitude_y_rad) if added else 0.0))


def figure_path(figure: Figure, observation: int, dither: np.ndarray, frame: HorizonFrame | None) -> ScanPath:
    """Compute the boresight path of the observation with a number."""
    time_s, scan, mid_s = sample_times(figure)
    half_s, n_samp, n_scan = figure.scan_s / 2, len(time_s), figure.n_scans
    ends_s = np.concatenate([mid_s - half_s, mid_s + half_s])
    offsets = _on_sky(figure, observation, np.append(time_s, ends_s), frame)
    travel = offsets[:, n_samp + n_scan :] - offsets[:, n_samp : n_samp + n_scan]
    xi, eta = offsets[:, :n_samp] + np.asarray(dither)[:, None]
    return ScanPath(
        time_s=time_s,
        xi_rad=xi,
        eta_rad=eta,
        scan=scan,
        velocity_rad_s=travel.T / figure.scan_s,
        mid_time_s=mid_s,
        straight=False,
    )


def lissajous_curve(figure: LissajousFigure, time_s: np.ndarray) -> np.ndarray:
    """Compute the offsets (2, n) of a Lissajous figure along x and y [rad] at times (n,)."""
    x = figure.amplitude_x_rad * np.sin(2 * np.pi * time_s / figure.period_x_s + figure.phase_rad)
    return np.stack([x, figure.amplitude_y_rad * np.sin(2 * np.pi * time_s / figure.period_y_s)])


def _on_sky(figure: Figure, observation: int, time_s: np.ndarray, frame: HorizonFrame | None) -> np.ndarray:
    """Compute the curve in the tangent plane, (2, n) along xi and eta."""
    x, y = figure.curve(time_s) + (lissajous_curve(figure.added, time_s) if figure.added else 0.0)
    angle = figure.angle_rad + observation * figure.angle_step_rad
    x, y = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
    if not figure.horizon:
        return np.stack([x, y])
    assert frame is not None, "a pattern in the frame of the horizon needs a schedule"
    centre = np.zeros_like(time_s)
    vertical = to_horizon(frame, time_s, centre, centre)[2]
    # Azimuth increases to the west of the vertical's position angle: as `surveysim.telescope.pointing.sky_vector`.
    return np.stack([-x * np.cos(vertical) + y * np.sin(vertical), x * np.sin(vertical) + y * np.cos(vertical)])
