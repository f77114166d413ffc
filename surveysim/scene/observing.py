"""Sections [field], [schedule] and [fixed_pointing]: where, when and how the telescope observes."""

from typing import Annotated, Any

from pydantic import Field

from surveysim.scene.fields import (
    Angle,
    Elevation,
    Height,
    HourAngle,
    IsoDate,
    Latitude,
    Longitude,
    whole,
)
from surveysim.scene.section import Section

_OF_SITE: Any = {"otherwise": "the site's"}


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
