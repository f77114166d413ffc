"""Sites that ship: place, water vapour, wind and layer height of each; `sites.toml` lists them with their sources."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from surveysim.scene.units import to_floats

OWN = "own"  # the site of a scene with a section [site]
PLACE_KEYS = ("title", "latitude", "longitude", "height", "temperature", "opacity")
PROFILE_KEY = "water_scale_height"  # taken by a scene with a profile alone
WATER_KEYS = (("pwv",), ("pwv_by_month", "pwv_by_hour"))  # a scene that gives one replaces the site's other


@cache
def sites_text() -> str:
    """Text of `sites.toml`, comments included."""
    return files("surveysim.scene").joinpath("sites.toml").read_text(encoding="utf-8")


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(sites_text())


@cache
def site_names() -> tuple[str, ...]:
    """Names of the sites that ship."""
    return tuple(name for name in _tables() if name != OWN)


def site_title(name: str) -> str:
    """Name of a site in a sentence."""
    return _tables().get(name, {}).get("title", name)


def site_place(name: str) -> dict[str, Any]:
    """Keys of the place of a site that ships: coordinates, temperature and table of opacity, as in `sites.toml`."""
    return {key: value for key, value in _tables()[name].items() if key in PLACE_KEYS}


def with_site(section: Mapping[str, Any]) -> dict[str, Any]:
    """Fill the keys that an [atmosphere] leaves out with those of its site, if it has one."""
    site = section.get("site")
    if not isinstance(site, str) or site not in _tables():
        return dict(section)
    return {key: value for key, value in _tables()[site].items() if is_taken(key, section)} | dict(section)


def is_taken(key: str, section: Mapping[str, Any]) -> bool:
    """Return whether an [atmosphere] takes a key from its site."""
    if key in PLACE_KEYS or key in section or (key == PROFILE_KEY and "profile" not in section):
        return False
    return not any(
        key in ours and any(other in section for other in theirs) for ours, theirs in (WATER_KEYS, WATER_KEYS[::-1])
    )


def water_mm(site: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Probabilities and quantiles [mm] of the water vapour of a site, all year."""
    table = _tables()[site]
    return tuple(table["pwv_probabilities"]), to_floats(table["pwv"], "mm")


def median_water_mm(site: str) -> float:
    """Median water vapour of a site [mm]."""
    return dict(zip(*water_mm(site), strict=True))[0.5]
