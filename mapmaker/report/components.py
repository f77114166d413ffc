"""Building blocks of a report page: sections with text, terms, tables and pictures."""

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar


@dataclass(frozen=True)
class Cell:
    """Text of a table cell; `value` is the unrounded number, None for a text; `link` leads to another page."""

    text: str
    value: float | None = None
    link: str = ""


@dataclass(frozen=True)
class Text:
    """Paragraphs."""

    kind: ClassVar = "text"
    paragraphs: tuple[str, ...]


@dataclass(frozen=True)
class Listing:
    """A list with an optional introductory line."""

    kind: ClassVar = "listing"
    items: tuple[str, ...]
    intro: str = ""


@dataclass(frozen=True)
class Terms:
    """Terms with their descriptions, and an optional title; `code` for terms that a program reads."""

    kind: ClassVar = "terms"
    pairs: tuple[tuple[str, str], ...]
    title: str = ""
    code: bool = False


@dataclass(frozen=True)
class Grid:
    """A table: the first cell of a row is its header, `best` are highlighted rows, `notes` stand below."""

    kind: ClassVar = "grid"
    anchor: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    best: tuple[int, ...] = ()

    @property
    def numeric(self) -> set[int]:
        """Indices of the columns that hold numbers."""
        return {place for row in self.rows for place, item in enumerate(row) if item.value is not None and place}


@dataclass(frozen=True)
class Picture:
    """A PNG as a data URI, its size in pixels, its text alternative, title and caption.

    `drawn` is a caption inside the picture: the page shows it as text where the picture is too small to read.
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
    """A part of a page with a heading; the table of contents lists its parts if it is `nested`."""

    anchor: str
    title: str
    blocks: tuple[Block, ...]
    nested: bool = False

    @property
    def parts(self) -> list[tuple[str, str]]:
        """Anchors and titles for the table of contents."""
        named = [block for block in self.blocks if self.nested and isinstance(block, Grid | Picture)]
        return [(block.anchor, block.title if isinstance(block, Picture) else block.caption) for block in named]


@dataclass(frozen=True)
class Page:
    """A whole page: its kind, title, summary lines, key figures, and sections."""

    kind: str
    title: str
    lead: tuple[str, ...]
    key_figures: tuple[tuple[str, str], ...] = ()
    sections: tuple[Section, ...] = ()


def picture(path: Path, title: str, alt: str, caption: Sequence[str], drawn: str = "") -> Picture:
    """Embed a PNG file in a page, byte for byte."""
    data = path.read_bytes()
    width, height = (int.from_bytes(data[start : start + 4], "big") for start in (16, 20))  # in the header IHDR
    uri = f"data:image/png;base64,{b64encode(data).decode()}"
    return Picture(f"figure-{path.stem}", uri, width, height, alt, title, tuple(caption), drawn)
