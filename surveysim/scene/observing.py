"""Sections that say where, when and how is observed."""

from typing import Annotated

from pydantic import Field

from surveysim.scene.fields import (
    Angle,
    AngleExtent,
    Duration,
    DurationExtent,
    Elevation,
    Frequency,
    Height,
    HourAngle,
    IsoDate,
    Latitude,
    Longitude,
    Speed,
    whole,
)
from surveysim.scene.section import Section

MIN_SAMPLES = 8  # fewer leave nothing of a scan once its mean and a few templates are removed


class FieldSection(Section):
    """The centre of the field (J2000)."""

    ra_rad: Longitude = Field(alias="ra")
    """Right ascension."""
    dec_rad: Latitude = Field(alias="dec")
    """Declination."""


class Schedule(Section):
    """Where and when the field is observed: elevation and parallactic angle come from real dates.

    Observations are spread evenly over the nights and, within a night, over the hours that the limits allow.
    """

    latitude_rad: Latitude = Field(alias="latitude")
    """Geodetic latitude of the telescope, north positive."""
    longitude_rad: Longitude = Field(alias="longitude")
    """Longitude of the telescope, east positive."""
    height_m: Height = Field(alias="height")
    """Height of the telescope above the ellipsoid."""
    first_night: IsoDate
    """Local date of the first evening."""
    nights: Annotated[int, *whole(1, 4000)]
    """How many nights in a row."""
    max_hour_angle_rad: HourAngle = Field(alias="max_hour_angle")
    """Largest distance from the meridian."""
    min_elevation_rad: Elevation = Field(alias="min_elevation")
    """Lowest elevation of the field's centre."""


class FixedPointing(Section):
    """A telescope at one elevation and parallactic angle, for scenes that need no dates."""

    elevation_rad: Elevation = Field(alias="elevation")
    """Elevation of every scan."""
    parallactic_angle_rad: Angle = Field(alias="parallactic_angle")
    """Position angle of the zenith, from north through east."""


class Scan(Section):
    """The raster of one observation: parallel scans there and back, along right ascension and declination in turn."""

    speed_rad_s: Speed = Field(alias="speed")
    """Speed of the boresight on the sky within a scan."""
    scans: Annotated[int, *whole(1, 100_000)]
    """Scans in one observation."""
    duration_s: Duration = Field(alias="duration")
    """Length of one scan, the turnaround not included; 8 samples or more."""
    turnaround_s: DurationExtent = Field(alias="turnaround")
    """Time between two scans, which is not simulated."""
    step_rad: AngleExtent = Field(alias="step")
    """Distance of neighbouring scans."""
    dither_rad: AngleExtent = Field(alias="dither")
    """Full range of the offset that each observation's raster has in both directions."""
    sample_rate_hz: Frequency = Field(alias="sample_rate")
    """Samples a second."""
