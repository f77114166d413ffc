"""Provenance of results: versions and time, as in every summary.json."""

import platform
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any

from surveysim import __version__

PACKAGES = ("numpy", "scipy", "numba", "astropy", "healpy", "ducc0", "h5py", "pydantic")


def made_by() -> dict[str, Any]:
    """Versions of surveysim, Python and the packages it computes with."""
    packages = {name: _version(name) for name in PACKAGES}
    return {"surveysim": __version__, "python": platform.python_version(), "packages": packages}


_version = cache(version)  # which reads files: sweeps write many summaries


def now() -> str:
    """Current time: ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
