"""Sites: water vapour, wind and layer height of each; `sites.toml` lists them with their sources."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from surveysim.scene.units import to_floats

SITES = ("mauna_kea", "south_pole", "alma", "ccat")


@cache
def sites_text() -> str:
    """Text of `sites.toml`, comments included."""
    return files("surveysim.scene").joinpath("sites.toml").read_text(encoding="utf-8")


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(sites_text())


def with_site(section: Mapping[str, Any]) -> dict[str, Any]:
    """Fill the keys that an [atmosphere] leaves out with those of its site, if it has one."""
    site = section.get("site")
    return (_tables()[site] if site in SITES else {}) | dict(section)


def water_mm(site: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Probabilities and quantiles [mm] of the water vapour of a site."""
    table = _tables()[site]
    return tuple(table["pwv_probabilities"]), to_floats(table["pwv"], "mm")


def median_water_mm(site: str) -> float:
    """Median water vapour of a site [mm]."""
    return dict(zip(*water_mm(site), strict=True))[0.5]
