"""Suggestions for a name that does not exist."""

from collections.abc import Iterable
from difflib import get_close_matches

LONGEST = 100  # letters of a name that are compared


def similar_names(name: str, names: Iterable[str]) -> list[str]:
    """Return the names that resemble a mistyped one, the closest first; at most three."""
    return get_close_matches(name[:LONGEST], list(dict.fromkeys(names)))


def did_you_mean(name: str, names: Iterable[str], section: str = "") -> str:
    """Return ``did you mean scan.speed?``, with the names of a section that resemble a mistyped one; empty if none."""
    similar = [f"{section}.{found}".lstrip(".") for found in similar_names(name, names)]
    return f"did you mean {' or '.join(similar)}?" if similar else ""
