"""The numbers of the paper that results are printed beside."""

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def published() -> dict[str, Any]:
    """`published.toml` as it stands; its comments name the section of the paper."""
    return tomllib.loads(files("surveysim.paper").joinpath("published.toml").read_text(encoding="utf-8"))
