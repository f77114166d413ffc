"""Where results come from: versions and the moment, as every summary.json has them."""

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

from surveysim import __version__

PACKAGES = ("numpy", "scipy", "numba", "astropy", "healpy", "ducc0", "h5py", "pydantic")


def made_by() -> dict[str, Any]:
    """Versions of what computes here."""
    packages = {name: version(name) for name in PACKAGES}
    return {"surveysim": __version__, "python": platform.python_version(), "packages": packages}


def now() -> str:
    """This moment: ISO 8601, UTC, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
