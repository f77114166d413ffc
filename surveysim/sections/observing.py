"""Sections that say where, when and how is observed."""

from pydantic import Field

from surveysim.quantities import (
    Angle,
    AngleExtent,
    Duration,
    DurationExtent,
    Elevation,
    ElevationLimit,
    Frequency,
    Height,
    HourAngle,
    IsoDate,
    Latitude,
    Longitude,
    Speed,
)
from surveysim.sections.base import Section


class FieldSection(Section):
    """The centre of the field (J2000)."""

    ra_rad: Longitude = Field(alias="ra")
    dec_rad: Latitude = Field(alias="dec")


class Schedule(Section):
    """Where and when the field is observed: elevation and parallactic angle come from real dates."""

    latitude_rad: Latitude = Field(alias="latitude")
    longitude_rad: Longitude = Field(alias="longitude")
    height_m: Height = Field(alias="height")
    first_night: IsoDate
    nights: int = Field(ge=1, le=10_000)
    max_hour_angle_rad: HourAngle = Field(alias="max_hour_angle")
    min_elevation_rad: ElevationLimit = Field(alias="min_elevation")


class FixedPointing(Section):
    """A telescope at one elevation and parallactic angle, for scenes that need no dates."""

    elevation_rad: Elevation = Field(alias="elevation")
    parallactic_angle_rad: Angle = Field(alias="parallactic_angle")


class Scan(Section):
    """The raster of one observation."""

    speed_rad_s: Speed = Field(alias="speed")
    scans: int = Field(ge=1, le=100_000)
    duration_s: Duration = Field(alias="duration")
    turnaround_s: DurationExtent = Field(alias="turnaround")
    step_rad: AngleExtent = Field(alias="step")
    dither_rad: AngleExtent = Field(alias="dither")
    sample_rate_hz: Frequency = Field(alias="sample_rate")
