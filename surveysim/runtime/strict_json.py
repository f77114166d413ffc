"""JSON that any reader accepts: NaN and infinity become null."""

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def strict_json(content: Any, **look: Any) -> str:
    """Write content as JSON text.

    NaN and infinity become null; scalars and arrays of numpy become numbers and lists.

    Parameters
    ----------
    content
        Nested mappings, sequences, numbers and text.
    **look
        Options of `json.dumps`, such as ``indent=2``.
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
    """Replace unknown values of an entry by None: JSON has no NaN."""
    return {key: None if value != value else value for key, value in entry.items()}
