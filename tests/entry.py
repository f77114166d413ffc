"""The command line as the package declares it: in this process, or as a command for another."""

import os
import sys
import tomllib
from importlib import import_module
from pathlib import Path

_SCRIPTS = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text())["project"]["scripts"]
MODULE, _, FUNCTION = _SCRIPTS["surveysim"].partition(":")
READERS_PATH = os.environ.get("PYTHONPATH", "")  # as it is outside the tests
COMMAND = (sys.executable, "-c", f"from {MODULE} import {FUNCTION}; {FUNCTION}()")


def main() -> None:
    """Run the entry point on `sys.argv`."""
    getattr(import_module(MODULE), FUNCTION)()
