"""Published numbers of the paper, for comparison with results."""

import tomllib
from functools import cache
from importlib.resources import files
from typing import Any


@cache
def published() -> dict[str, Any]:
    """Return the content of `published.toml`; its comments name the sections of the paper."""
    return tomllib.loads(files("surveysim.paper").joinpath("published.toml").read_text(encoding="utf-8"))
