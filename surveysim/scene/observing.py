"""Sections [field], [schedule], [fixed_pointing] and [scan]: where, when and how the telescope observes."""

from typing import Annotated, Any

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

_OF_SITE: Any = {"otherwise": "the site's"}
MIN_SAMPLES = 8  # scans with fewer samples would vanish with their mean and a few templates


class FieldSection(Section):
    """Centre of the field (J2000)."""

    ra_rad: Longitude = Field(alias="ra")
    """Right ascension of the centre."""
    dec_rad: Latitude = Field(alias="dec")
    """Declination of the centre."""


class Schedule(Section):
    """Place and dates of the observations, which give elevation and parallactic angle.

    A site, named in [atmosphere] or given in [site], supplies the place. Observations are spread evenly over the nights
    and, within a night, over the time in which the field is within the limits.
    """

    latitude_rad: Latitude = Field(alias="latitude", json_schema_extra=_OF_SITE)
    """Geodetic latitude of the telescope, north positive."""
    longitude_rad: Longitude = Field(alias="longitude", json_schema_extra=_OF_SITE)
    """Longitude of the telescope, east positive."""
    height_m: Height = Field(alias="height", json_schema_extra=_OF_SITE)
    """Height of the telescope above the ellipsoid."""
    first_night: IsoDate
    """Local date of the first night, at its evening."""
    nights: Annotated[int, *whole(1, 4000)]
    """Number of consecutive nights."""
    max_hour_angle_rad: HourAngle = Field(alias="max_hour_angle")
    """Largest hour angle of the field's centre, east or west."""
    min_elevation_rad: Elevation = Field(alias="min_elevation")
    """Lowest elevation of the field's centre."""


class FixedPointing(Section):
    """One elevation and one parallactic angle for all observations, without dates."""

    elevation_rad: Elevation = Field(alias="elevation")
    """Elevation of every scan."""
    parallactic_angle_rad: Angle = Field(alias="parallactic_angle")
    """Parallactic angle: position angle of the zenith, from north through east."""


class Scan(Section):
    """Raster of one observation: parallel scans in alternating directions, along right ascension in one observation and
    declination in the next."""

    speed_rad_s: Speed = Field(alias="speed")
    """Speed of the boresight on the sky during a scan."""
    scans: Annotated[int, *whole(1, 100_000)]
    """Number of scans in one observation."""
    duration_s: Duration = Field(alias="duration")
    """Duration of one scan without turnaround; 8 samples or more."""
    turnaround_s: DurationExtent = Field(alias="turnaround")
    """Duration of the turnaround between two scans, which is not simulated."""
    step_rad: AngleExtent = Field(alias="step")
    """Distance between neighbouring scans."""
    dither_rad: AngleExtent = Field(alias="dither")
    """Full range of the raster's offset, drawn uniformly for each observation in both directions."""
    sample_rate_hz: Frequency = Field(alias="sample_rate")
    """Sampling rate of the time-streams."""
