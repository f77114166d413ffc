"""Fixtures of the tests of `mapmaker`'s command line."""

import pytest


@pytest.fixture(autouse=True)
def own_handlers(handlers):
    """The program sets signal handlers; a test run keeps its own."""
