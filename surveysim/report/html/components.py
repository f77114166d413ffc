"""What a page of a report is made of: sections with text, terms, tables and pictures; and how numbers are written."""

import math
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

UK2 = "µK²_CMB"
MINUS, TIMES, NARROW = "\u2212", "\u00d7", "\u202f"
EXACT = 1e-9  # relative error below which a number has none but that of its rounding


@dataclass(frozen=True)
class Cell:
    """Text of a table's cell; `value` is the number that it rounds, None for a text."""

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Text:
    """Paragraphs."""

    kind: ClassVar = "text"
    paragraphs: tuple[str, ...]


@dataclass(frozen=True)
class Listing:
    """A list under a line that introduces it, if any."""

    kind: ClassVar = "listing"
    items: tuple[str, ...]
    intro: str = ""


@dataclass(frozen=True)
class Terms:
    """Terms, each with what is said of it, below a title, if any; `code` for what a program reads."""

    kind: ClassVar = "terms"
    pairs: tuple[tuple[str, str], ...]
    title: str = ""
    code: bool = False


@dataclass(frozen=True)
class Grid:
    """A table: the first cell of a row is its head, `best` are rows to point out. `notes` stand below."""

    kind: ClassVar = "grid"
    anchor: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    best: tuple[int, ...] = ()

    @property
    def numeric(self) -> set[int]:
        """Places of the columns that hold numbers."""
        return {place for row in self.rows for place, item in enumerate(row) if item.value is not None and place}


@dataclass(frozen=True)
class Picture:
    """A PNG as a data URI, its size in pixels, the text in its place, and a caption below its title.

    `drawn` is a caption that the picture itself holds: it is shown where the picture is too small to read it.
    """

    kind: ClassVar = "picture"
    anchor: str
    uri: str
    width: int
    height: int
    alt: str
    title: str
    caption: tuple[str, ...]
    drawn: str = ""


Block = Text | Listing | Terms | Grid | Picture


@dataclass(frozen=True)
class Section:
    """A part of a page with a heading; the table of contents names the parts in it where it is `nested`."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]
    nested: bool = False

    @property
    def parts(self) -> list[tuple[str, str]]:
        """Anchor and title of what the table of contents names."""
        named = [block for block in self.blocks if self.nested and isinstance(block, Grid | Picture)]
        return [(block.anchor, block.title if isinstance(block, Picture) else block.caption) for block in named]


@dataclass(frozen=True)
class Page:
    """A whole page: what it is of, its title, what it says in a few lines, key figures, and its sections."""

    kind: str
    title: str
    lead: tuple[str, ...]
    key_figures: tuple[tuple[str, str], ...] = ()
    sections: tuple[Section, ...] = ()


def picture(path: Path, title: str, alt: str, caption: Sequence[str], drawn: str = "") -> Picture:
    """A PNG file as a part of a page, at its own bytes."""
    data = path.read_bytes()
    width, height = (int.from_bytes(data[start : start + 4], "big") for start in (16, 20))  # of the header IHDR
    uri = f"data:image/png;base64,{b64encode(data).decode()}"
    return Picture(f"figure-{path.stem}", uri, width, height, alt, title, tuple(caption), drawn)


# ---------------------------------------------------------------- numbers


def cell(value: object) -> Cell:
    """A text or a count as it stands."""
    if isinstance(value, int) and not isinstance(value, bool):
        return Cell(count(value), value)
    return Cell(str(value))


def measured(value: float | None, error: float | None = None) -> Cell:
    """A number rounded to two digits of its error, or to three of its own; empty for none."""
    if value is None or not math.isfinite(value):
        return Cell("")
    return Cell(with_error(value, error), value)


def times(value: float | None, factor: float) -> float | None:
    """A number of a summary times a factor; None, as null is read, stays what it is."""
    return None if value is None else value * factor


def with_error(value: float, error: float | None) -> str:
    """``221.1 ± 5.2``: both rounded to two digits of the error; three digits without one, or where it is rounding's."""
    if error is None or not (math.isfinite(error) and error > EXACT * abs(value)):
        return number(value)
    size = max(abs(value), error)
    if 1e-3 <= size < 1e6:
        return f"{as_known(value, error)} ± {as_known(error, error)}"
    exponent = math.floor(math.log10(size))
    scale = 10.0**exponent
    return f"({with_error(value / scale, error / scale)}) {TIMES} 10^({_signed(str(exponent))})"


def quoted(value: float | None, error: float | None) -> str:
    """As `with_error`, but an error of None is said to be unknown, as a value of None is."""
    if value is None:
        return "unknown"
    return f"{number(value)} ± unknown" if error is None else with_error(value, error)


def as_known(value: float, error: float | None) -> str:
    """A number rounded to two digits of an error, or to three of its own where that is unknown."""
    if error is None or value is None:
        return number(value)
    return _fixed(value, 1 - int(f"{error:.1e}".partition("e")[2]))  # of the rounded error: 0.0996 is 0.10


def number(value: float | None, digits: int = 3) -> str:
    """A number of so many digits, without exponent from 0.001 to a million; "none" for None."""
    if value is None:
        return "none"
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "none"
    rounded = float(f"{value:.{digits - 1}e}")
    if not 1e-3 <= abs(rounded) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{_signed(mantissa)} {TIMES} 10^({_signed(str(int(exponent)))})"
    return _fixed(value, digits - 1 - math.floor(math.log10(abs(rounded))))


def short(value: float) -> str:
    """A number as it was given, up to six digits, without trailing zeros."""
    if value != 0 and not 1e-3 <= abs(value) < 1e6:  # NaN too
        return number(value)
    return _signed(_grouped(f"{value:,.6g}", value))


def percent(share: float | None, error: float | None = None) -> str:
    """A share in percent, as `with_error` writes numbers; "unknown" for None."""
    if share is None:
        return "unknown"
    if error is not None and error > 0:
        return f"({with_error(100 * share, 100 * error)}) %"
    return f"{number(100 * share, 2)} %"


def count(value: float | None) -> str:
    """A number without decimals, its digits in threes from five on; "none" for None."""
    return "none" if value is None else _fixed(value, 0)


def day_and_time(date: str) -> str:
    """A moment as summary.json has it, for readers."""
    return date.replace("T", " ").replace("+00:00", " UTC")


def duration(seconds: float | None) -> str:
    """A time in the unit that suits it; "unknown" for None."""
    if seconds is None:
        return "unknown"
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 1.5 * size:
            return f"{number(seconds / size, 2)} {unit}"
    return f"{number(seconds, 2)} s" if seconds >= 0.1 else f"{number(1e3 * seconds, 2)} ms"


def plural(n: int, thing: str) -> str:
    """How many of a thing there are."""
    return f"{count(n)} {thing}" if n == 1 else f"{count(n)} {thing}s"


def joined(items: Sequence[str]) -> str:
    """``a, b and c``."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}" if items else ""


def _fixed(value: float, places: int) -> str:
    return _signed(_grouped(f"{round(value, places):,.{max(places, 0)}f}", value))


def _grouped(text: str, value: float) -> str:
    """A number with commas between thousands: apart from five digits on, without below."""
    return text.replace(",", NARROW if abs(value) >= 1e4 else "")


def _signed(text: str) -> str:
    return text.replace("-", MINUS)
