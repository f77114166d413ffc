"""Fixtures of the tests of studies."""

import pytest


@pytest.fixture(scope="module")
def write(tmp_path_factory):
    """Write a scene file; returns its path."""

    def write(text):
        path = tmp_path_factory.mktemp("scene") / "white.toml"
        path.write_text(text)
        return path

    return write
