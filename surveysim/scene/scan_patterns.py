"""Section [scan]: the path of the telescope in one observation, one class for each pattern."""

import math
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from surveysim.scene.fields import AngleExtent, Duration, DurationExtent, Speed, whole
from surveysim.scene.scan_figures import DaisyScan, LissajousFigure, LissajousScan, PongScan
from surveysim.scene.scan_section import MOST_SCANS, ScanSection
from surveysim.scene.scan_sweeps import AzimuthScan, SweepScan
from surveysim.scene.scan_track import TrackScan
from surveysim.scene.unions import union_of


class RasterScan(SweepScan):
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
    """Duration of the turnaround between two scans."""
    step_rad: AngleExtent = Field(alias="step")
    """Distance between neighbouring scans."""
    lissajous: LissajousFigure | None = None

    @property
    def fastest_rad_s(self) -> float:
        """Speed of a scan, and the largest of a Lissajous figure that is added."""
        return self.speed_rad_s + (math.hypot(*self.lissajous.peak_speeds_rad_s) if self.lissajous else 0.0)


SCAN_SECTIONS: tuple[type[ScanSection], ...] = (RasterScan, AzimuthScan, DaisyScan, LissajousScan, PongScan, TrackScan)


if TYPE_CHECKING:
    AnyScan = ScanSection
else:
    AnyScan = union_of(SCAN_SECTIONS, "pattern", "raster")
