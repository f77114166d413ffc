"""Fields of a YAML description, with the keys that were read."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surveysim.runtime.errors import InputError
from surveysim.runtime.text_files import one_line, read_text
from surveysim.scene.units import shown, to_float

MAX_BYTES = 1_000_000
MAX_DEPTH = 20
MOST_VALUES = 10_000
ABSENT = ("", "~", "null", "Null", "NULL", "none", "None")


@dataclass(frozen=True)
class Field:
    """Value of a description and its key; numbers and absent values are still texts."""

    key: str
    value: Any

    @property
    def absent(self) -> bool:
        """Return whether the value is null."""
        return isinstance(self.value, str) and self.value in ABSENT

    @property
    def file(self) -> str | None:
        """File of a distribution over frequency or of a probability distribution."""
        if isinstance(self.value, dict) and self.value.get("var_type") in ("dist", "pdf"):
            return str(self.value.get("fname", ""))
        return None


Fields = Mapping[str, Field]


@dataclass(frozen=True)
class Allowed:
    """Unit of a number, unit of a bare number, and bounds in the former; the lower one excluded if `above`."""

    unit: str = ""
    bare: str = ""
    low: float = 0.0
    high: float = math.inf
    above: bool = True

    def holds(self, value: float) -> bool:
        """Return whether a value is within the bounds."""
        return (self.low < value if self.above else self.low <= value) and value <= self.high

    @property
    def bounds(self) -> str:
        """The bounds in words."""
        low = f"{'above' if self.above else 'from'} {self.low:g}"
        return f"a number {low}{'' if math.isinf(self.high) else f' to {self.high:g}'} {self.unit}".rstrip()


SHARE = Allowed(high=1.0, above=False)
POSITIVE = Allowed()
KELVIN = Allowed("K", "K")


class Reader:
    """Content of a YAML file, each scalar a text; keys that were read, and their last parts.

    Raises InputError, one line, for a file that can't be read.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.used: set[str] = set()
        self.names: set[str] = set()
        self.content = _read(path)

    def fields(self, key: str, default: Any = None) -> dict[str, Field]:
        """Fields of the mapping at a dotted key; of `default`, if there is none. Raises InputError for no mapping."""
        node: Any = self.content
        for part in key.split("."):
            node = node.get(part) if isinstance(node, dict) else None
        if node is None and default is None:
            raise InputError(f"{key}: missing; a mapping is expected")
        return fields_of(Field(key, default if node is None else node))

    def text(self, fields: Fields, name: str) -> str | None:
        """Text of a field; None where it is absent."""
        found = fields.get(name)
        if found is None or found.absent:
            return None
        self.note(found)
        if not isinstance(found.value, str):
            raise InputError(f"{found.key}: found {shown(found.value)}; a text is expected")
        return found.value

    def number(self, fields: Fields, name: str, allowed: Allowed, place: int = 0) -> float | None:
        """Read a number; None where it is absent.

        Parameters
        ----------
        place
            Number of the channel from 0, for a list with one value for each.

        Raises
        ------
        InputError
            With the key, the value found and the value expected.
        """
        found = fields.get(name)
        if found is None or found.absent:
            return None
        self.note(found, ("var_type", "value", "unit", "scale"))
        text, bare, scale = found.value, allowed.bare, 1.0
        if isinstance(text, dict):
            if found.file is not None or "value" not in text:
                raise InputError(f"{found.key}: found {shown(text)}; a number is expected")
            bare = str(text.get("unit", bare))
            scale = _quantity(f"{found.key}.scale", text.get("scale", "1"), Allowed())
            text = text["value"]
        if isinstance(text, list):
            chosen = 0 if len(text) == 1 else place
            if chosen >= len(text):
                raise InputError(f"{found.key}: found {len(text)} values; one for each channel is expected")
            text = text[chosen]
        if isinstance(text, str) and text in ABSENT:
            return None
        value = scale * _quantity(found.key, text, Allowed(allowed.unit, bare))
        if not allowed.holds(value):
            raise InputError(f"{found.key}: found {shown(text)}; {allowed.bounds} is expected")
        return value

    def require(self, fields: Fields, name: str, allowed: Allowed, place: int = 0) -> float:
        """Read a number. Raises InputError as `number`, and where it is absent."""
        value = self.number(fields, name, allowed, place)
        if value is None:
            raise InputError(f"{name}: missing; {allowed.bounds} is expected")
        return value

    def table(self, found: Field, place: int = 0) -> tuple[list[float], list[float]]:
        """Read the first two columns of the file that a field names.

        Raises
        ------
        InputError
            For a file that is missing, rows that are not two or three numbers, and a first column that does not
            increase.
        """
        self.note(found, ("var_type", "fname"))
        names = (found.file or "").split(",")
        path = self.path.parent / names[min(place, len(names) - 1)].strip()
        try:
            lines = read_text(path, MAX_BYTES).splitlines()
        except InputError as error:
            raise InputError(f"{found.key}: {path}: {error}") from None
        rows = []
        for number, line in enumerate(lines, 1):
            cells = line.split("#")[0].replace(",", " ").split()
            if cells:
                rows.append(_row(f"{found.key}: {path}: row {number}", cells))
        if len(rows) < 2:
            raise InputError(f"{found.key}: {path}: found {len(rows)} rows; 2 or more are expected")
        if any(high[0] <= low[0] for low, high in zip(rows, rows[1:], strict=False)):
            raise InputError(f"{found.key}: {path}: first column: increasing numbers are expected")
        return [row[0] for row in rows], [row[1] for row in rows]

    def note(self, found: Field, parts: Sequence[str] = ()) -> None:
        """Note that a field was read, or left out on purpose; of a mapping only `parts`, if they are given."""
        whole = not parts or not isinstance(found.value, dict)
        self.used |= {found.key} if whole else {f"{found.key}.{part}" for part in parts}
        self.names.add(found.key.split(".")[-1])

    def unused(self) -> list[str]:
        """Keys of values that were not read, null values aside, in the order of the file."""
        return [key for key, value in _leaves(self.content) if value not in ABSENT and not self._was_read(key)]

    def _was_read(self, key: str) -> bool:
        parts = key.split(".")
        return any(".".join(parts[:count]) in self.used for count in range(1, len(parts) + 1))


def fields_of(found: Field) -> dict[str, Field]:
    """Fields of a mapping; none of an absent one. Raises InputError for anything else."""
    if found.absent:
        return {}
    if not isinstance(found.value, dict):
        raise InputError(f"{found.key}: found {shown(found.value)}; a mapping is expected")
    return {str(name): Field(f"{found.key}.{name}", value) for name, value in found.value.items()}


def _read(path: Path) -> dict[str, Any]:
    import yaml

    text = read_text(path, MAX_BYTES)
    try:
        content = yaml.load(text, Loader=yaml.BaseLoader)  # makes texts, lists and mappings only
    except yaml.YAMLError as error:
        raise InputError(f"not a valid YAML file ({one_line(error)})") from None
    except RecursionError:
        raise InputError("nested too deeply; a description of a camera is expected") from None
    if not isinstance(content, dict):
        raise InputError(f"found {shown(content)}; a mapping with the key instrument is expected")
    for _ in _leaves(content):  # refuses too many values
        pass
    return content


def _leaves(content: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of all scalars, in order; items of lists are numbered. Raises InputError for deep or
    endless content, as aliases of YAML can make it."""
    stack: list[tuple[str, Any, int]] = [("", content, 0)]
    for _ in range(MOST_VALUES):
        if not stack:
            return
        key, value, depth = stack.pop()
        if depth > MAX_DEPTH:
            raise InputError("nested too deeply; a description of a camera is expected")
        if isinstance(value, dict | list):
            pairs = value.items() if isinstance(value, dict) else enumerate(value)
            stack += [(f"{key}.{name}" if key else str(name), item, depth + 1) for name, item in pairs][::-1]
        else:
            yield key, value
    raise InputError(f"found {MOST_VALUES} values or more; fewer are expected")


def _quantity(key: str, text: Any, allowed: Allowed) -> float:
    if not isinstance(text, str):
        raise InputError(f"{key}: found {shown(text)}; a number is expected")
    written = text.replace("rtHz", "Hz(1/2)")
    try:
        bare = math.isfinite(float(text))
    except ValueError:
        bare = False
    try:
        return to_float(f"{written} {allowed.bare}" if bare else written, allowed.unit)
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


def _row(place: str, cells: list[str]) -> list[float]:
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        values = []
    if len(values) not in (2, 3) or not all(map(math.isfinite, values)):
        raise InputError(f"{place}: found {shown(' '.join(cells))}; 2 or 3 numbers are expected")
    return values
