"""Section [scan]: the path of the telescope in one observation, one class for each pattern."""

import math
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from surveysim.scene.fields import AngleExtent, Duration, DurationExtent, Frequency, PositiveAngle, Speed, whole
from surveysim.scene.section import Section
from surveysim.scene.unions import union_of

MIN_SAMPLES = 8  # scans with fewer samples would vanish with their mean and a few templates
MOST_SCANS = 100_000
_PHASES = 4096  # of a mean over a period


class ScanSection(Section):
    """Base of the patterns, with the numbers that every pattern has as keys or properties.

    Attributes
    ----------
    speed_rad_s
        Mean speed of the boresight on the sky during a scan.
    fastest_rad_s
        Largest speed of the boresight on the sky.
    scans
        Number of scans in one observation.
    duration_s, turnaround_s
        Duration of one scan, and of the time between two.
    duration_key
        Key that sets the duration of a scan.
    """

    pattern: str
    """Pattern of the scans."""
    dither_rad: AngleExtent = Field(alias="dither")
    """Full range of the pattern's offset, drawn uniformly for each observation in both directions."""
    sample_rate_hz: Frequency = Field(alias="sample_rate")
    """Sampling rate of the time-streams."""
    duration_key: ClassVar[str] = "scan.duration"

    if TYPE_CHECKING:

        @property
        def speed_rad_s(self) -> float: ...  # noqa: D102
        @property
        def fastest_rad_s(self) -> float: ...  # noqa: D102
        @property
        def scans(self) -> int: ...  # noqa: D102
        @property
        def duration_s(self) -> float: ...  # noqa: D102
        @property
        def turnaround_s(self) -> float: ...  # noqa: D102


class RasterScan(ScanSection):
    """Raster of one observation: parallel scans in alternating directions, along right ascension in one observation and
    declination in the next."""

    pattern: Literal["raster"] = "raster"
    """Pattern of the scans."""
    speed_rad_s: Speed = Field(alias="speed")
    """Speed of the boresight on the sky during a scan."""
    scans: Annotated[int, *whole(1, MOST_SCANS)]
    """Number of scans in one observation."""
    duration_s: Duration = Field(alias="duration")
    """Duration of one scan without turnaround; 8 samples or more."""
    turnaround_s: DurationExtent = Field(alias="turnaround")
    """Duration of the turnaround between two scans, which is not simulated."""
    step_rad: AngleExtent = Field(alias="step")
    """Distance between neighbouring scans."""

    @property
    def fastest_rad_s(self) -> float:
        """Speed of the boresight."""
        return self.speed_rad_s


class ChunkedScan(ScanSection):
    """Base of the patterns without natural scans, which are cut into chunks of equal duration."""

    total_s: Duration = Field(alias="duration")
    """Duration of one observation; a remainder shorter than a chunk is left out."""
    duration_s: Duration = Field(alias="chunk")
    """Duration of the chunks that cleaning treats as scans; 8 samples or more."""
    duration_key: ClassVar[str] = "scan.chunk"

    @property
    def scans(self) -> int:
        """Number of chunks in one observation."""
        return int(self.total_s / self.duration_s * (1 + 1e-12))

    @property
    def turnaround_s(self) -> float:
        """Time between two chunks: none."""
        return 0.0

    @model_validator(mode="after")
    def _has_chunks(self) -> Self:
        if not 1 <= self.scans <= MOST_SCANS:
            raise ValueError(
                f"chunk: found {self.duration_s:g} s in a duration of {self.total_s:g} s; a chunk that fits 1 to"
                f" {MOST_SCANS} times is expected"
            )
        return self


class DaisyScan(ChunkedScan):
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


SCAN_SECTIONS: tuple[type[ScanSection], ...] = (RasterScan, DaisyScan)


if TYPE_CHECKING:
    AnyScan = ScanSection
else:
    AnyScan = union_of(SCAN_SECTIONS, "pattern", "raster")
