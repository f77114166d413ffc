"""JSON that every reader takes: numbers that are unknown or infinite are null."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def strict_json(content: Any, **look: Any) -> str:
    """The content as JSON text; `look` are options of `json.dumps`, as ``indent=2``.

    JSON has no NaN and no infinity: they become null. Scalars and arrays of numpy become numbers and lists. Raises
    TypeError for what is no JSON at all.
    """
    return json.dumps(_plain(content), allow_nan=False, **look)


def _plain(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def known(entry: dict[str, Any]) -> dict[str, Any]:
    """The entry with None for what is unknown: JSON has no NaN."""
    return {key: None if value != value else value for key, value in entry.items()}
