"""Sites: the water, the wind and the layer above each, as `sites.toml` lists them with their sources."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from surveysim.scene.units import to_floats

SITES = ("mauna_kea", "south_pole", "alma", "ccat")


@cache
def sites_text() -> str:
    """`sites.toml` as it stands, comments and all."""
    return files("surveysim.scene").joinpath("sites.toml").read_text(encoding="utf-8")


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(sites_text())


def with_site(section: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of an `[atmosphere]`, those that it leaves out as the site that it names has them, if it does."""
    site = section.get("site")
    return (_tables()[site] if site in SITES else {}) | dict(section)


def water_mm(site: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Probabilities of a site's water columns, and the columns [mm]."""
    table = _tables()[site]
    return tuple(table["pwv_probabilities"]), to_floats(table["pwv"], "mm")


def median_water_mm(site: str) -> float:
    """Median water column of a site [mm], one of the quantiles that it lists."""
    return dict(zip(*water_mm(site), strict=True))[0.5]
