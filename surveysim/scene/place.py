"""Place of a telescope on Earth, on which pointing and opacity depend, and the section [site] that gives it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from surveysim.scene.fields import Height, Latitude, Longitude, TableFile, quantity
from surveysim.scene.section import Section
from surveysim.scene.sites import OWN, site_names, site_place
from surveysim.scene.units import to_float, to_sky_angle

COORDINATES = ("latitude", "longitude", "height")
NOWHERE = {"latitude": "0 deg", "longitude": "0 deg", "height": "0 m"}  # of a section [site] that is refused
AirTemperature = Annotated[float, *quantity("K", at_least="150 K", at_most="330 K")]


@dataclass(frozen=True)
class Place:
    """Place of a telescope, and the air above it.

    Attributes
    ----------
    name
        Name of a site that ships, or "own".
    latitude_rad, longitude_rad, height_m
        Geodetic coordinates, north and east positive.
    temperature_k
        Temperature of the air at the height of the place, above a surface inversion.
    opacity
        Table of optical depth; None for the table of all heights.
    """

    name: str
    latitude_rad: float
    longitude_rad: float
    height_m: float
    temperature_k: float
    opacity: Path | None


class SiteSection(Section):
    """A place anywhere on Earth. Its weather is in [atmosphere], without `site`. Its dates are in [schedule], without
    `latitude`, `longitude` and `height`.

    The opacity follows from the height and the temperature of the air, unless a table is given.
    """

    latitude_rad: Latitude = Field(alias="latitude")
    """Geodetic latitude of the telescope, north positive."""
    longitude_rad: Longitude = Field(alias="longitude")
    """Longitude of the telescope, east positive."""
    height_m: Height = Field(alias="height")
    """Height of the telescope above the sea; 0 to 6000 m without a table of opacity."""
    temperature_k: AirTemperature | None = Field(
        alias="temperature", default=None, json_schema_extra={"otherwise": "of the latitude and height"}
    )
    """Temperature of the air at this height, above a surface inversion. It sets the temperature and pressure of the air
    above, and so the opacity."""
    opacity: TableFile = None
    """ECSV table of zenith optical depth: a column `frequency`, a column such as `pwv_0.5` for each amount of water
    in mm, and `atmosphere_temperature` in the metadata. Without it the program's table for any height is used."""


def usual_temperature_k(latitude_rad: float, height_m: float) -> float:
    """Usual air temperature: 310 K, less 6.5 K/km with height and 50 K with the squared sine of the latitude.

    Calibrated against medians of the ERA5 reanalysis above the sites that ship: within 12 K of each.
    """
    return 310.0 - 6.5e-3 * height_m - 50.0 * math.sin(latitude_rad) ** 2


@cache
def shipped_place(name: str) -> Place:
    """Return the place of a site that ships."""
    found = site_place(name)
    table = found.get("opacity")
    return Place(
        name,
        to_sky_angle(found["latitude"]),
        to_sky_angle(found["longitude"]),
        to_float(found["height"], "m"),
        to_float(found["temperature"], "K"),
        Path(str(files("surveysim.atmosphere"))) / "tables" / table if table else None,
    )


def own_place(section: SiteSection) -> Place:
    """Return the place of a section [site]."""
    temperature_k = section.temperature_k
    if temperature_k is None:
        temperature_k = usual_temperature_k(section.latitude_rad, section.height_m)
    return Place(OWN, section.latitude_rad, section.longitude_rad, section.height_m, temperature_k, section.opacity)


def with_place(scene: Mapping[str, Any]) -> dict[str, Any]:
    """Fill the place of [schedule] and the site of [atmosphere] in the content of a scene, as it is in the file.

    Raises
    ------
    ValueError
        For a scene with a section [site] that names a site or gives a place in [schedule] too, and for one without the
        section that its site stands for.
    """
    found = dict(scene)
    own, air, plan = (found.get(name) for name in ("site", "atmosphere", "schedule"))
    if isinstance(own, dict) and isinstance(air, dict):
        if air.get("site", OWN) != OWN:
            raise ValueError(f"atmosphere.site: found {air['site']!r} with a section [site]; one of them is expected")
        found["atmosphere"] = air | {"site": OWN}
    if own is None and isinstance(air, dict) and air.get("site") == OWN:
        raise ValueError(f"site: missing; atmosphere.site {OWN!r} is the place of a section [site]")
    if isinstance(plan, dict):
        found["schedule"] = _placed(plan, own if isinstance(own, dict) else None, air)
    return found


def _placed(plan: dict[str, Any], own: dict[str, Any] | None, air: object) -> dict[str, Any]:
    """Return a [schedule] with the keys of its place."""
    if own is not None:
        if twice := [key for key in COORDINATES if plan.get(key) is not None]:
            raise ValueError(f"schedule.{twice[0]}: found with a section [site]; it is expected there alone")
        return plan | (NOWHERE if _is_wrong(own) else {key: own[key] for key in COORDINATES})
    site = air.get("site") if isinstance(air, dict) else None
    if site not in site_names():
        return plan
    return {key: value for key, value in site_place(site).items() if key in COORDINATES} | plan


def _is_wrong(section: dict[str, Any]) -> bool:
    try:
        SiteSection.model_validate(section)
    except ValidationError:
        return True
    return False
