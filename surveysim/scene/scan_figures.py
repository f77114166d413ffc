"""Sections [scan] of closed curves about the centre of the field: daisy, Lissajous figure and pong."""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from surveysim.scene.fields import Angle, Duration, PositiveAngle, Speed, whole
from surveysim.scene.scan_section import ChunkedScan

_PHASES = 4096  # of a mean over a period, or over all pairs of phases
_SHARE = (math.sqrt(5) - 1) / 2  # of a turn between neighbouring pairs of phases, which are then evenly spread
MOST_TERMS = 100


class FigureScan(ChunkedScan):
    """Base of the patterns that are curves about the centre."""

    total_s: Duration = Field(alias="duration")
    """Duration of one observation; a remainder shorter than a chunk is left out."""
    frame: Literal["sky", "horizon"] = "sky"
    """Axes of the pattern in the tangent plane: "sky" has x east and y north, "horizon" x along azimuth and y up along
    the vertical through the centre, so that the pattern turns on the sky."""
    angle_rad: Angle = Field(alias="angle", default=0.0)
    """Angle by which the pattern is turned from x to y."""
    angle_step_rad: Angle = Field(alias="angle_step", default=0.0)
    """Further turn of the pattern from each observation to the next."""

    @property
    def needs_horizon(self) -> str:
        """Key and value of the frame."""
        return "frame: found 'horizon'" if self.frame == "horizon" else ""


class DaisyScan(FigureScan):
    """Daisy of one observation: the boresight oscillates through the centre along a diameter that turns."""

    pattern: Literal["daisy"]
    """Pattern of the scans."""
    radius_rad: PositiveAngle = Field(alias="radius")
    """Largest distance of the boresight from the centre."""
    radial_period_s: Duration = Field(alias="radial_period")
    """Period of the oscillation along the diameter: the time of two petals."""
    rotation_period_s: Duration | None = Field(
        alias="rotation_period", default=None, json_schema_extra={"otherwise": "pi times `radial_period`"}
    )
    """Period of the rotation of the diameter. That of the Green Bank Telescope is pi times `radial_period`; the rose
    then almost closes after 22 radial periods."""

    @property
    def turn_s(self) -> float:
        """Period of the rotation, whether or not it is given."""
        return self.rotation_period_s or math.pi * self.radial_period_s

    @property
    def speed_rad_s(self) -> float:
        """Speed averaged over time: the radial speed goes as the cosine of a phase, the tangential one as its sine."""
        phase = 2 * np.pi * np.arange(_PHASES) / _PHASES
        radial, tangential = np.cos(phase) / self.radial_period_s, np.sin(phase) / self.turn_s
        return float(2 * np.pi * self.radius_rad * np.hypot(radial, tangential).mean())

    @property
    def fastest_rad_s(self) -> float:
        """Speed at the centre, or along the rim if the rotation is the faster motion."""
        return 2 * math.pi * self.radius_rad / min(self.radial_period_s, self.turn_s)


class LissajousScan(FigureScan):
    """Lissajous figure of one observation: sines along both axes, with periods of their own."""

    pattern: Literal["lissajous"]
    """Pattern of the scans."""
    amplitude_x_rad: PositiveAngle = Field(alias="amplitude_x")
    """Largest offset from the centre along x."""
    amplitude_y_rad: PositiveAngle = Field(alias="amplitude_y")
    """Largest offset from the centre along y."""
    period_x_s: Duration = Field(alias="period_x")
    """Period along x."""
    period_y_s: Duration = Field(alias="period_y")
    """Period along y."""
    phase_rad: Angle = Field(alias="phase", default=0.0)
    """Phase of the sine along x at the start of an observation; that along y has none."""

    @property
    def peak_speeds_rad_s(self) -> tuple[float, float]:
        """Largest speeds along x and y."""
        x, y = self.amplitude_x_rad / self.period_x_s, self.amplitude_y_rad / self.period_y_s
        return 2 * math.pi * x, 2 * math.pi * y

    @property
    def speed_rad_s(self) -> float:
        """Speed averaged over the phases along both axes, as over a figure that takes long to close."""
        (x, y), (one, other) = self.peak_speeds_rad_s, _phases()
        return float(np.hypot(x * np.cos(one), y * np.cos(other)).mean())

    @property
    def fastest_rad_s(self) -> float:
        """Speed where both axes are at their fastest, which only some figures reach."""
        return math.hypot(*self.peak_speeds_rad_s)


class PongScan(FigureScan):
    """Pong of one observation: diagonals that bounce within a box, with rounded corners."""

    pattern: Literal["pong"]
    """Pattern of the scans."""
    width_rad: PositiveAngle = Field(alias="width")
    """Smallest width of the box, along x."""
    height_rad: PositiveAngle = Field(alias="height")
    """Smallest height of the box, along y."""
    spacing_rad: PositiveAngle = Field(alias="spacing")
    """Distance between neighbouring parallel lines."""
    velocity_rad_s: Speed = Field(alias="velocity")
    """Speed of the boresight along the lines, without the rounding of corners."""
    terms: Annotated[int, *whole(1, MOST_TERMS)]
    """Number of terms of the Fourier series of the triangle waves along both axes: fewer round the corners more. The
    scan planner of FYST has 5."""

    @property
    def vertices(self) -> tuple[int, int]:
        """Numbers of vertices on the sides along x and y: coprime, one of them even."""
        return _vertices(*(math.ceil(side / self._step_rad) for side in (self.width_rad, self.height_rad)))

    @property
    def _step_rad(self) -> float:
        """Distance of vertices on a side."""
        return math.sqrt(2) * self.spacing_rad

    @property
    def amplitudes_rad(self) -> tuple[float, float]:
        """Half the width and height of the box with sharp corners."""
        x, y = self.vertices
        return x * self._step_rad / 2, y * self._step_rad / 2

    @property
    def periods_s(self) -> tuple[float, float]:
        """Periods along x and y: each axis has the velocity over the square root of 2."""
        x, y = (4 * amplitude * math.sqrt(2) / self.velocity_rad_s for amplitude in self.amplitudes_rad)
        return x, y

    @property
    def speed_rad_s(self) -> float:
        """Speed averaged over the phases along both axes."""
        one, other = (self._axis_speed(phase) for phase in _phases())
        return float(np.hypot(one, other).mean())

    @property
    def fastest_rad_s(self) -> float:
        """Speed where both axes are at their fastest, above `velocity` by the overshoot of the series."""
        return float(math.sqrt(2) * np.abs(self._axis_speed(np.linspace(0, np.pi / 2, _PHASES))).max())

    def _axis_speed(self, phase_rad: np.ndarray) -> np.ndarray:
        """Velocity along an axis at phases (n,) of its triangle wave [rad/s]."""
        odd = 2 * np.arange(self.terms)[:, None] + 1
        square = 4 / np.pi * ((-1.0) ** (odd // 2) * np.cos(odd * phase_rad) / odd).sum(axis=0)
        return self.velocity_rad_s / math.sqrt(2) * square


def _phases() -> tuple[np.ndarray, np.ndarray]:
    """Pairs of phases, evenly spread over all pairs."""
    number = np.arange(_PHASES)
    return 2 * np.pi * number / _PHASES, 2 * np.pi * ((number * _SHARE) % 1.0)


def _vertices(x: int, y: int) -> tuple[int, int]:
    """Enlarge numbers of vertices until they are coprime and one of them is even: the pattern then fills the box."""
    if x % 2 == y % 2:
        x, y = (x, y + 1) if x >= y else (x + 1, y)
    while math.gcd(x, y) != 1:
        x, y = (x + 2, y) if x >= y else (x, y + 2)
    return x, y
