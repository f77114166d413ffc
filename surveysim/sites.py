"""Sites: the water, the wind and the layer above each, as `sites.toml` lists them with their sources."""

import tomllib
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any

SITES = ("mauna_kea", "south_pole", "alma", "ccat")


@cache
def sites_text() -> str:
    """`sites.toml` as it stands, comments and all."""
    return files("surveysim").joinpath("sites.toml").read_text(encoding="utf-8")


@cache
def _tables() -> dict[str, dict[str, Any]]:
    return tomllib.loads(sites_text())


def with_site(section: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of an `[atmosphere]`, those that it leaves out as the site that it names has them, if it does."""
    site = section.get("site")
    return (_tables()[site] if site in SITES else {}) | dict(section)
