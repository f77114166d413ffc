"""Names of output directories: a separate one for each set of overrides."""

import json
import re
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

OUTPUTS = Path("outputs")
MOST_LETTERS = 120  # longest directory name: file systems allow 255 bytes
_OF_HASH = 8
_MOST_OF_VALUE = 30
# What a value may be to stand in a name as it is, less its spaces and with "-" for "/": no two values then share one.
_KEY = re.compile(r"[A-Za-z0-9_.-]+")
_VALUE = re.compile(
    r"(?:[A-Za-z0-9_.]|-(?=[0-9.])|(?<=[0-9.]) (?=[A-Za-z])|(?<=[A-Za-z]) ?/ ?(?=[A-Za-z]))*[A-Za-z0-9_]"
)


def default_directory(name: str, settings: Mapping[str, Any]) -> Path:
    """Return the default directory of a scene's results, a separate one for each set of overrides.

    The name contains the overrides as ``key=value``, in the order of their keys. A long value, or one with characters
    that some file systems refuse, is cut and followed by `~` and a part of its hash. A removed key has no value. The
    key ``name`` is left out, as it is the scene's `name` already.
    """
    given = {key: settings[key] for key in sorted(settings) if key != "name"}
    whole = "+".join([name, *(f"{_key(key)}={_value(value)}" for key, value in given.items())])
    if len(whole) > MOST_LETTERS:
        whole = f"{whole[: MOST_LETTERS - _OF_HASH - 1]}~{_hash(given)}"
    return OUTPUTS / whole


def _key(key: str) -> str:
    return key if _KEY.fullmatch(key) else _cut(key)


def _value(value: Any) -> str:
    plain = [_plain(item) for item in value] if isinstance(value, list) and len(value) > 1 else [_plain(value)]
    return _cut(value) if None in plain else ",".join(plain)


def _plain(value: Any) -> str | None:
    """Text of a value for a file name; None if it is not allowed, or looks like a value of another type."""
    if value is None:
        return ""
    if isinstance(value, bool | int | float):
        return str(value).lower().replace("+", "")
    if not isinstance(value, str) or not _VALUE.fullmatch(value) or _is_toml(value):
        return None
    return re.sub(r" ?/ ?", "-", value).replace(" ", "")


def _is_toml(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text in ("true", "false")
    return True


def _cut(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value, default=str)
    letters = re.sub(r"[^A-Za-z0-9_.]+", "-", text).strip("-.")
    return f"{letters[:_MOST_OF_VALUE]}~{_hash(value)}"


def _hash(value: Any) -> str:
    text = json.dumps(value, sort_keys=True, default=repr)
    return sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:_OF_HASH]
