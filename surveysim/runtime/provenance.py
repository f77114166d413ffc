"""Provenance of results: versions and time, as in every summary.json."""

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from surveysim import __version__

PACKAGES = ("numpy", "scipy", "numba", "astropy", "healpy", "ducc0", "h5py", "pydantic")


def made_by() -> dict[str, Any]:
    """Versions of surveysim, Python and the packages it computes with."""
    packages = {name: version(name) for name in PACKAGES}
    return {"surveysim": __version__, "python": platform.python_version(), "packages": packages}


def now() -> str:
    """Current time: ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
