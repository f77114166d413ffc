"""A table of results before it is a file: columns, units and what is said of the whole."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Table:
    """Columns of equal length by name, units of those that have one, and what is said of the whole."""

    columns: dict[str, Any]
    units: dict[str, str] = field(default_factory=dict)
    meta: dict[str, Any] = field(default_factory=dict)
