"""Text of a scene: tables of keys with values and the origin of each."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

from surveysim.runtime.text_files import one_line

_COMMENT_COLUMN = 40


@dataclass(frozen=True)
class Row:
    """Key, value and origin of the value, in the words of a comment."""

    key: str
    value: object
    origin: str


@dataclass(frozen=True)
class Table:
    """Heading with its brackets, empty for the keys before all tables, and rows."""

    heading: str
    rows: tuple[Row, ...]


def measured(value: float, unit: str) -> str:
    """Quantity with four digits."""
    return f"{value:.4g} {unit}"


def scene_text(comments: Sequence[str], tables: Sequence[Table]) -> str:
    """Write tables as TOML after comments."""
    lines = [f"# {one_line(comment)}" for comment in comments]
    for table in tables:
        lines += ["", table.heading] if table.heading else [""]
        lines += [_line(row) for row in table.rows]
    return "\n".join(lines) + "\n"


def _line(row: Row) -> str:
    # JSON's texts, numbers and lists are TOML's.
    setting = f"{row.key} = {json.dumps(row.value, ensure_ascii=False)}"
    return f"{setting:<{_COMMENT_COLUMN - 1}} # {one_line(row.origin)}" if row.origin else setting
