"""Section [telescope]: limits of the mount."""

from pydantic import Field

from surveysim.scene.fields import Acceleration, Jerk, Speed
from surveysim.scene.section import Section


class TelescopeSection(Section):
    """Limits of an alt-azimuth mount: a scene with a faster track is refused.

    The azimuth is that of the axis: for the same speed on the sky it moves faster by 1 / cos(elevation).
    """

    max_azimuth_velocity_rad_s: Speed | None = Field(alias="max_azimuth_velocity", default=None)
    """Largest velocity in azimuth."""
    max_elevation_velocity_rad_s: Speed | None = Field(alias="max_elevation_velocity", default=None)
    """Largest velocity in elevation."""
    max_azimuth_acceleration_rad_s2: Acceleration | None = Field(alias="max_azimuth_acceleration", default=None)
    """Largest acceleration in azimuth, also on average over a turnaround that is not simulated."""
    max_elevation_acceleration_rad_s2: Acceleration | None = Field(alias="max_elevation_acceleration", default=None)
    """Largest acceleration in elevation, also on average over a turnaround that is not simulated."""
    max_azimuth_jerk_rad_s3: Jerk | None = Field(alias="max_azimuth_jerk", default=None)
    """Largest jerk in azimuth within scans."""
    max_elevation_jerk_rad_s3: Jerk | None = Field(alias="max_elevation_jerk", default=None)
    """Largest jerk in elevation within scans."""

    def limit(self, axis: str, order: int) -> float | None:
        """Limit of a derivative of "azimuth" or "elevation" in time, the velocity's order being 1; None without any."""
        name, unit = (("velocity", "s"), ("acceleration", "s2"), ("jerk", "s3"))[order - 1]
        found: float | None = getattr(self, f"max_{axis}_{name}_rad_{unit}")
        return found
