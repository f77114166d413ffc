"""Sections [scan] of closed curves about the centre of the field: daisy, Lissajous figure and pong."""

import math
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from pydantic import Field

from surveysim.scene.fields import Angle, Duration, PositiveAngle, Speed, whole
from surveysim.scene.scan_section import ChunkedScan
from surveysim.scene.section import Section

_PHASES = 4096  # of a mean over a period, or over all tuples of phases
# Shares of a turn by which further phases advance, powers of the plastic number: tuples are then evenly spread.
_SHARES = (0.7548776662466927, 0.5698402909980532, 0.4301597090019468)
MOST_TERMS = 100
_Velocity = tuple[np.ndarray, np.ndarray]


class LissajousFigure(Section):
    """Lissajous figure that is added to a curve, so that the curve covers its area more evenly.

    MUSTANG-2 adds one to its daisies, TolTEC to Lissajous figures and rasters.
    """

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

    def velocity_at(self, one: np.ndarray, other: np.ndarray) -> _Velocity:
        """Velocity along x and y at phases (n,) along these [rad/s]."""
        x, y = self.peak_speeds_rad_s
        return x * np.cos(one), y * np.cos(other)


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
    lissajous: LissajousFigure | None = None

    @property
    def needs_horizon(self) -> str:
        """Key and value of the frame."""
        return "frame: found 'horizon'" if self.frame == "horizon" else ""

    @property
    def speed_rad_s(self) -> float:
        """Speed averaged over all phases, as over a figure that takes long to close."""
        one, other, third, fourth = _phases()
        x, y = self.velocity_at(one, other)
        if self.lissajous:
            more_x, more_y = self.lissajous.velocity_at(third, fourth)
            x, y = x + more_x, y + more_y
        return float(np.hypot(x, y).mean())

    @property
    def fastest_rad_s(self) -> float:
        """Speed that is reached where all motions are at their fastest in one direction, which is not always so."""
        more = math.hypot(*self.lissajous.peak_speeds_rad_s) if self.lissajous else 0.0
        return self.peak_speed_rad_s + more

    if TYPE_CHECKING:

        @property
        def peak_speed_rad_s(self) -> float: ...  # noqa: D102
        def velocity_at(self, one: np.ndarray, other: np.ndarray) -> _Velocity: ...  # noqa: D102


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
    def peak_speed_rad_s(self) -> float:
        """Speed at the centre, or along the rim if the rotation is the faster motion."""
        return 2 * math.pi * self.radius_rad / min(self.radial_period_s, self.turn_s)

    def velocity_at(self, one: np.ndarray, other: np.ndarray) -> _Velocity:
        """Velocity along x and y at phases (n,) of the oscillation and of the rotation [rad/s]."""
        peak = 2 * np.pi * self.radius_rad
        radial, tangential = peak * np.cos(one) / self.radial_period_s, peak * np.sin(one) / self.turn_s
        cos, sin = np.cos(other), np.sin(other)
        return radial * cos - tangential * sin, radial * sin + tangential * cos


class LissajousScan(FigureScan, LissajousFigure):
    """Lissajous figure of one observation: sines along both axes, with periods of their own."""

    pattern: Literal["lissajous"]
    """Pattern of the scans."""

    @property
    def peak_speed_rad_s(self) -> float:
        """Speed where both axes are at their fastest."""
        return math.hypot(*self.peak_speeds_rad_s)

    velocity_at = LissajousFigure.velocity_at


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
    def peak_speed_rad_s(self) -> float:
        """Speed where both axes are at their fastest, above `velocity` by the overshoot of the series."""
        return float(math.sqrt(2) * np.abs(self._axis_speed(np.linspace(0, np.pi / 2, _PHASES))).max())

    def velocity_at(self, one: np.ndarray, other: np.ndarray) -> _Velocity:
        """Velocity along x and y at phases (n,) along these [rad/s]."""
        return self._axis_speed(one), self._axis_speed(other)

    def _axis_speed(self, phase_rad: np.ndarray) -> np.ndarray:
        """Velocity along an axis at phases (n,) of its triangle wave [rad/s]."""
        odd = 2 * np.arange(self.terms)[:, None] + 1
        square = 4 / np.pi * ((-1.0) ** (odd // 2) * np.cos(odd * phase_rad) / odd).sum(axis=0)
        return self.velocity_rad_s / math.sqrt(2) * square


def _phases() -> tuple[np.ndarray, ...]:
    """Tuples of four phases, evenly spread over all; the first takes a turn in equal steps."""
    number = np.arange(_PHASES)
    return 2 * np.pi * number / _PHASES, *(2 * np.pi * ((number * share) % 1.0) for share in _SHARES)


def _vertices(x: int, y: int) -> tuple[int, int]:
    """Enlarge numbers of vertices until they are coprime and one of them is even: the pattern then fills the box."""
    if x % 2 == y % 2:
        x, y = (x, y + 1) if x >= y else (x + 1, y)
    while math.gcd(x, y) != 1:
        x, y = (x + 2, y) if x >= y else (x, y + 2)
    return x, y
