"""Sections [scan] of patterns that sweep there and back, with turnarounds between."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from surveysim.scene.fields import Acceleration, DurationExtent, Jerk, PositiveAngle, Speed, whole
from surveysim.scene.scan_section import MOST_SCANS, ScanSection


class SweepScan(ScanSection):
    """Base of the patterns with turnarounds.

    Attributes
    ----------
    ramp_s
        Time in which the acceleration of a turnaround rises, and that in which it falls.
    """

    there_and_back: ClassVar[bool] = True

    turnarounds: Literal["left out", "flagged"] = "left out"
    """"flagged": turnarounds are simulated, half of one at both ends of each scan. Filters take interpolated samples in
    their place; maps have none of them."""

    @property
    def scan_s(self) -> float:
        """Duration of a scan, with its turnarounds where they are simulated."""
        return self.duration_s + (self.turnaround_s if self.turnarounds == "flagged" else 0.0)

    @property
    def gap_s(self) -> float:
        """Time between two scans."""
        return 0.0 if self.turnarounds == "flagged" else self.turnaround_s

    @property
    def ramp_s(self) -> float:
        """Half of the turnaround: its acceleration is a triangle."""
        return self.turnaround_s / 2


class AzimuthScan(SweepScan):
    """Sweeps in azimuth at constant elevation: those of the field's centre at the middle of the observation.

    The field drifts through. Needs a section [schedule].
    """

    pattern: Literal["azimuth"]
    """Pattern of the scans."""
    angles: Literal["sky", "azimuth"] = "sky"
    """Speed, throw, acceleration and jerk are angles on the sky, or azimuths: larger by 1 / cos(elevation)."""
    speed_rad_s: Speed = Field(alias="speed")
    """Speed of a sweep."""
    throw_rad: PositiveAngle = Field(alias="throw")
    """Length of a sweep at constant speed."""
    scans: Annotated[int, *whole(1, MOST_SCANS)]
    """Number of sweeps in one observation."""
    given_turnaround_s: DurationExtent | None = Field(
        alias="turnaround", default=None, json_schema_extra={"otherwise": "from `acceleration` and `jerk`"}
    )
    """Duration of the turnaround between two sweeps."""
    acceleration_rad_s2: Acceleration | None = Field(alias="acceleration", default=None)
    """Alternative to `turnaround`: largest acceleration in a turnaround."""
    jerk_rad_s3: Jerk | None = Field(alias="jerk", default=None, json_schema_extra={"otherwise": "no limit"})
    """Largest rate of change of the acceleration."""

    duration_key: ClassVar[str] = "scan.throw"

    @property
    def needs_horizon(self) -> str:
        """Azimuths and elevations need it."""
        return "pattern: found 'azimuth'"

    @property
    def fastest_rad_s(self) -> float:
        """Speed of a sweep; in azimuth it is an upper bound of the speed on the sky."""
        return self.speed_rad_s

    @property
    def duration_s(self) -> float:
        """Duration of a sweep."""
        return self.throw_rad / self.speed_rad_s

    @property
    def turnaround_s(self) -> float:
        """Duration of a turnaround, given or from the limits of the acceleration and its rate."""
        if self.given_turnaround_s is not None:
            return self.given_turnaround_s
        return 2 * self.speed_rad_s / self._peak_rad_s2 + self.ramp_s

    @property
    def ramp_s(self) -> float:
        """Time in which the acceleration rises to its limit; half of a turnaround of a given duration."""
        if self.given_turnaround_s is not None:
            return self.given_turnaround_s / 2
        return self._peak_rad_s2 / self.jerk_rad_s3 if self.jerk_rad_s3 else 0.0

    @property
    def _peak_rad_s2(self) -> float:
        """Largest acceleration: the limit, or less where the velocity has turned before it is reached."""
        limit = self.acceleration_rad_s2 or 0.0
        return min(limit, (2 * self.speed_rad_s * self.jerk_rad_s3) ** 0.5) if self.jerk_rad_s3 else limit

    @model_validator(mode="after")
    def _turns_in_one_way(self) -> Self:
        if (self.given_turnaround_s is None) == (self.acceleration_rad_s2 is None):
            found = "missing" if self.given_turnaround_s is None else "found with 'acceleration'"
            raise ValueError(f"turnaround: {found}; exactly one of 'turnaround' and 'acceleration' is expected")
        if self.jerk_rad_s3 is not None and self.acceleration_rad_s2 is None:
            raise ValueError("jerk: found without 'acceleration', which it limits the change of")
        return self
